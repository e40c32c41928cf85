"""A press of a ball as the product reads it."""

from injected_presses import RADIUS_MM

from fem.indentation.ball import Ball
from fem.indentation.trace import IndenterTrace


def ball_trace(time_s, force_N, travel_mm, *, radius_mm=RADIUS_MM, **more) -> IndenterTrace:
    """Of the injected presses' ball, unless of another."""
    ball = Ball(radius_mm=radius_mm)
    return IndenterTrace(time_s=time_s, force_N=force_N, travel_mm=travel_mm, geometry=ball, **more)
