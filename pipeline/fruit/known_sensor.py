"""What is known of a recording's gel: what batch.toml states, else what the shipped sensor model says."""

from dataclasses import replace

from pipeline.batch.settings import SensorSettings
from tactile.readers.sensor_model import PublishedGel, gel_of_model, model_named


def known_gels(sensor: str, settings: SensorSettings | None) -> tuple[PublishedGel, ...]:
    """Of the sensor that a recording names; `settings`: [sensor] of the batch, whose stiffness is first."""
    model = model_named(sensor)
    shipped = () if model is None else (gel_of_model(model),)
    gel_stiffness = {} if settings is None else settings.gel_stiffness
    if not gel_stiffness:
        return shipped
    stated = PublishedGel(source="[sensor] in batch.toml", stiffness=gel_stiffness)
    others = {
        name: known for gel in shipped for name, known in gel.stiffness.items() if name not in gel_stiffness
    }
    return (stated, *(replace(gel, stiffness=others) for gel in shipped))
