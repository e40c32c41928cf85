"""Detection statistics of sound recordings: fruits, noise, surfaces, pits and places drawn anew."""

NAMES = ("best single", "best pair", "what is left", "friction cone")
NULLS: tuple[tuple[float, ...], ...] = ((1.0, 1.0, 1.0, 1.0), (2.0, 2.0, 1.1, -1.0))
