"""Charts of one fruit: force against travel, residual, and E by frame."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import chain

import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls

from reports.charts import Chart, band, layer, padded, with_note, without_outliers
from reports.entries import FruitEntry
from reports.grasp_record import CurveRecord, GraspRecord
from reports.language import say
from reports.messages import message
from reports.words import number

_MOST_POINTS = 80
"""Most marks of one pad: on a drawing 360 px wide, more would be less than 4 px apart."""
_CURVE_POINTS = 24
"""Points of the model's curve: one in 15 px of that drawing."""
_POWERS = (1 / 3, 2 / 3, 1.0)
"""Powers of the force in a travel: slower than a ball's (Hertz: 2/3), a ball's, and in series a spring's."""
LEAST_CERTAIN = 0.2
"""A frame whose modulus has at least this relative error does not influence the chart's scale."""
_SHAPES = ("circle", "square")


def fruit_charts(fruit: FruitEntry) -> list[Chart]:
    """All charts of a fruit: force and residual of each recording, then E by frame."""
    charts = [
        chart for recording in fruit.recordings if recording.curves for chart in _of_recording(recording)
    ]
    if any(recording.frames for recording in fruit.recordings):
        charts.append(_frames(fruit))
    return [*map(with_note, charts)]


def _of_recording(recording: GraspRecord) -> list[Chart]:
    """Force over travel; with a fitted model also its curve, and a second chart of the residuals."""
    curves = [curve for curve in recording.curves if np.isfinite(curve.travel_mm).any()]
    model = model_curve(curves)
    across = padded(_travels(curves), from_zero=True)
    x = {"label": say("travel since first touch (mm)"), "limits": across}
    force = chain(*(curve.force_N for curve in curves))
    peaks = (
        f"{say('pad')} {message(curve.pad)}: {number(float(np.nanmax(curve.force_N)))} N" for curve in curves
    )
    of_force: Chart = {
        "title": f"{say('Force against travel')}, {recording.grasp}",
        "description": "; ".join(peaks) or say("No frames in contact"),
        "caption": say("recorded force"),
        "x": x,
        "y": {"label": say("force (N)"), "limits": padded(force, from_zero=True)},
        "layers": [_pad_marks(curve, curve.force_N, k) for k, curve in enumerate(curves)],
        "group": recording.grasp,
    }
    if model is None:
        return [of_force]
    travel_mm, force_N, sd_mm = model
    edges = np.r_[travel_mm - 2 * sd_mm, (travel_mm + 2 * sd_mm)[::-1]], np.r_[force_N, force_N[::-1]]
    spread = layer("area", *edges, colour="cx")
    line = layer("line", travel_mm, force_N, colour="ink", smooth=True, name=say("fitted model"))
    residuals = [residual_um(curve, travel_mm, force_N) for curve in curves]
    rms_um = math.sqrt(np.nanmean(np.square(np.concatenate(residuals))))
    zero = layer("line", across, (0.0, 0.0), colour="soft")
    caption = say(
        "marks: recording; line: travel of the fitted model under the same force; "
        "band: ± 2 standard deviations of this grasp's E"
    )
    of_residuals: Chart = {
        "title": f"{say('Residual')}, {recording.grasp}",
        "description": f"{say('root mean square')} {number(rms_um)} µm",
        "caption": say(
            "recorded travel less the travel of the model's curve at the same force. "
            "A pattern shows physics that the model misses"
        ),
        "x": x,
        "y": {"label": say("residual (µm)"), "limits": padded([0.0, *without_outliers(chain(*residuals))])},
        "layers": [
            zero,
            *(_pad_marks(*pair, k) for k, pair in enumerate(zip(curves, residuals, strict=True))),
        ],
        "group": recording.grasp,
        "low": True,
    }
    return [of_force | {"caption": caption, "layers": [spread, *of_force["layers"], line]}, of_residuals]


def model_curve(
    curves: list[CurveRecord],
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"], Float[np.ndarray, " m"]] | None:
    """Travel (mm), force (N) and the travel's standard deviation (mm) of the fitted model, by rising force.

    Markers' noise scatters the frames of all pads. The curve is the least-squares sum of a constant and of
    _POWERS with coefficients of at least 0: the travel rises, ever more slowly. None without a model.
    """
    models = [curve.model for curve in curves if curve.model is not None]
    points = np.array(
        [point for m in models for point in zip(m.force_N, m.travel_mm, m.sd_mm, strict=True)], dtype=float
    ).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return None
    force_N = np.maximum(points[:, 0], 0.0)
    drawn_N = np.linspace(force_N.min(), force_N.max(), _CURVE_POINTS)
    travel_mm, sd_mm = (
        _terms(drawn_N) @ nnls(_terms(force_N), scattered)[0] for scattered in points[:, 1:].T
    )
    return travel_mm, drawn_N, np.maximum(sd_mm, 0.0)


def _terms(force_N: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n k"]:
    """A constant of either sign, and powers of the force."""
    constant = np.ones_like(force_N)
    return np.column_stack([constant, -constant, *(force_N**power for power in _POWERS)])


def residual_um(
    curve: CurveRecord, travel_mm: Float[np.ndarray, " m"], force_N: Float[np.ndarray, " m"]
) -> Float[np.ndarray, " f"]:
    """Recorded travel minus the travel of the model's curve at the same force, µm; NaN outside the curve."""
    recorded = np.array(curve.force_N, dtype=float)
    modelled = np.interp(recorded, force_N, travel_mm, left=np.nan, right=np.nan)
    missed_mm: np.ndarray = np.array(curve.travel_mm, dtype=float) - modelled
    return 1e3 * missed_mm


def _travels(curves: list[CurveRecord]) -> Iterable[float]:
    """All travels, recorded and modelled, mm."""
    yield from chain(*(curve.travel_mm for curve in curves))
    yield from chain(*(curve.model.travel_mm for curve in curves if curve.model is not None))


def _pad_marks(curve: CurveRecord, up: Iterable[float], k: int) -> Chart:
    """One pad's marks over travel: finite points, thinned evenly to at most _MOST_POINTS."""
    points = np.column_stack([curve.travel_mm, list(up)])
    points = points[np.isfinite(points).all(axis=1)]
    points = points[:: max(1, math.ceil(len(points) / _MOST_POINTS))]
    how = {"name": f"{say('pad')} {message(curve.pad)}", "colour": f"pad{k % 4}", "shape": _SHAPES[k % 2]}
    return layer("marks", points[:, 0], points[:, 1], **how)


def _frames(fruit: FruitEntry) -> Chart:
    """E from each frame alone over travel, for all grasps; band: the fruit's E ± one standard deviation."""
    by_recording = {recording.grasp: recording.frames for recording in fruit.recordings if recording.frames}
    frames = [frame for rows in by_recording.values() for frame in rows]
    sure = [frame.E_MPa for frame in frames if frame.E_sd_MPa < LEAST_CERTAIN * frame.E_MPa]
    across = padded((frame.travel_mm for frame in frames), from_zero=True)
    low, high = _spread(fruit) or (math.nan, math.nan)
    layers = [band(across, (low, low), (high, high))]
    for k, (name, rows) in enumerate(by_recording.items()):
        for unloading in (False, True):
            shown = [row for row in rows if row.unloading == unloading]
            how: Chart = {"colour": f"pad{k % 4}", "shape": _SHAPES[k % 2], "faint": unloading}
            how |= {} if unloading else {"name": name}
            places = [row.travel_mm for row in shown], [row.E_MPa for row in shown]
            layers.append(layer("marks", places[0], places[1], **how))
    ranges = (
        f"{name}: {number(min(row.E_MPa for row in rows))} to {number(max(row.E_MPa for row in rows))} MPa"
        for name, rows in by_recording.items()
    )
    return {
        "title": say("Modulus by frame"),
        "description": "; ".join(ranges),
        "caption": say(
            "E from each single frame (hollow: during opening). A trend up to the largest travel shows "
            "physics that the model misses. Grey: the fruit's value ± its standard deviation"
        ),
        "x": {"label": say("travel since first touch (mm)"), "limits": across},
        "y": {"label": "E (MPa)", "limits": padded([*sure, *_spread(fruit)])},
        "layers": layers,
    }


def _spread(fruit: FruitEntry) -> list[float]:
    """E minus and plus one standard deviation, MPa; empty if E is unknown."""
    sd = fruit.E_sd_MPa or 0.0
    return [] if fruit.E_MPa is None else [fruit.E_MPa - sd, fruit.E_MPa + sd]
