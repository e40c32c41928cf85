"""What each parameter of an effect means, in words."""

PARAMETERS = {
    "g": "share of the resistance that fades",
    "tau_s": "time over which it fades",
    "b": "how fast the flesh stiffens",
    "Et_N_per_mm": "stiffness of the skin",
    "gamma": "change of firmness from skin (−) to pit (+)",
    "centre_mm": "centre of the spot",
    "radius_mm": "radius of the spot",
    "ratio": "firmness of the spot over that of the flesh",
    "axial": "extra stiffness along the stem axis",
    "nu": "Poisson's ratio",
    "offset_mm": "where the pit is, less where it is expected",
    "scale": "size of the pit over the expected",
    "gap_mm": "gap between flesh and pit",
    "mu": "friction between pad and skin",
    "yield_over_E": "stress at which a dent stays, over E",
    "dmax": "most of the resistance that is lost",
    "W0_over_E": "energy at which it is lost, over E",
    "onset_mm": "travel at which the first touch came",
    "pad": "which pad",
    "gain": "recorded force over true force",
    "newton_per_s": "growth of the reading per second",
    "mm_per_N": "how far each jaw gives way per newton",
    "lag_s": "how late force and displacement are against the jaws",
    "shift_mm": "shift of the pad in its plane",
    "tilt_deg": "tilt of the pad",
}
"""By the names of docs/formats.md."""


def parameter_words(name: str) -> str:
    """The meaning, of further arms (`g_2`) and of a pair's parameters (`effect.name`) too.

    >>> parameter_words("tau_2_s")
    'time over which it fades'
    """
    own = name.rpartition(".")[2]
    parts = [part for part in own.split("_") if not part.isdigit()]
    return PARAMETERS.get(own) or PARAMETERS.get("_".join(parts), name.replace("_", " "))
