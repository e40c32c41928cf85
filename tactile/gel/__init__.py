"""Mechanics of a gel: compliance of a bonded slab, and forces on its face from marker displacement."""
