"""How far a rig itself gives way: fitted to squeezes of a rigid object, taken off travels and apertures."""
