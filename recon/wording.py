"""Names in a sentence."""

from collections.abc import Sequence

FEW_NAMES = 6
"""Most names in a sentence. Set by hand."""


def listed(names: Sequence[str]) -> str:
    """Names separated by commas; after the first six, only the number of the others.

    >>> listed(["a.jpg", "b.jpg"]), listed([f"{i}" for i in range(8)])
    ('a.jpg, b.jpg', '0, 1, 2, 3, 4, 5 and 2 more')
    """
    some = ", ".join(names[:FEW_NAMES])
    return some if len(names) <= FEW_NAMES else f"{some} and {len(names) - FEW_NAMES} more"
