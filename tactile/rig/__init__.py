"""Compliance of a rig: fitted to squeezes of a rigid object, subtracted from travels and apertures."""
