"""What is known of a recording's gel: what batch.toml states, else what the shipped sensor model says."""

from dataclasses import replace

from pipeline.batch.settings import SensorSettings
from tactile.io.sensor_model import PublishedGel, gel_of_model, model_named


def known_gels(sensor: str, settings: SensorSettings | None) -> tuple[PublishedGel, ...]:
    """Of the sensor that a recording names; `settings`: [sensor] of the batch, whose stiffness is first."""
    model = model_named(sensor)
    shipped = () if model is None else (gel_of_model(model),)
    own = {} if settings is None else settings.gel_stiffness
    if not own:
        return shipped
    stated = PublishedGel(source="[sensor] in batch.toml", stiffness=own)
    others = {name: known for one in shipped for name, known in one.stiffness.items() if name not in own}
    return (stated, *(replace(one, stiffness=others) for one in shipped))
