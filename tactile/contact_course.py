"""The course of a contact: in every frame, of every pad, its force, its patch, and how much of it sticks."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from tactile.contact import Contact
from tactile.patch import patch_of
from tactile.stick import stick_ratio

LAG_FRAMES = 3
"""Motion is compared over so many frames: one alone is lost in the noise of slow grasps."""
SCATTER_MM = 0.005
"""Single markers of a real gel (Tac3D) scatter by 2 to 20 µm from frame to frame, half of them by less
than 1 µm."""


@dataclass(frozen=True, kw_only=True)
class Course:
    """One pad, frame by frame; `stick_ratio` is the share of touching markers that stick, 0 in the air."""

    pad: str
    touches: Bool[np.ndarray, " t"]
    normal_N: Float[np.ndarray, " t"]
    patch_mm2: Float[np.ndarray, " t"]
    stick_ratio: Float[np.ndarray, " t"]


def contact_course(contact: Contact) -> tuple[Course, ...]:
    """Of all pads of a recording's contact (tactile.contact.find_contact)."""
    found = []
    for pad in contact.pads:
        touching = pad.episode >= 0
        noise_mm = max(pad.displacement_noise.sd, SCATTER_MM)
        found.append(
            Course(
                pad=pad.name,
                touches=np.asarray(touching.any(axis=1)),
                normal_N=pad.total_normal_N,
                patch_mm2=np.array([patch_of(pad.rest_mm, now).area_mm2 for now in touching]),
                stick_ratio=stick_ratio(pad.position_mm, touching, noise=noise_mm, lag=LAG_FRAMES).ratio,
            )
        )
    return tuple(found)


def said(course: Course, time_s: Float[np.ndarray, " t"]) -> str:
    """One line for people: when the pad touches, how hard, on how large a patch, and whether it slips."""
    at = np.flatnonzero(course.touches)
    starts = 1 + int((np.diff(at) > 1).sum())
    again = f" in {starts} contacts" if starts > 1 else ""
    hardest = int(course.normal_N.argmax())
    return (
        f"{course.pad}: contact from {time_s[at[0]]:.2f} to {time_s[at[-1]]:.2f} s{again}, up to "
        f"{course.normal_N[hardest]:.2f} N on {course.patch_mm2[hardest]:.0f} mm², where "
        f"{100 * course.stick_ratio[hardest]:.0f} % of the contact sticks"
    )
