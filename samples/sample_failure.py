"""Failures to make a sample."""


class SampleFailure(Exception):
    """One sentence: what is missing or did not work, and what to do."""


class RendererMissing(SampleFailure):
    """A renderer is not installed; the sentence says how to install it."""


class NotInEquilibrium(SampleFailure):
    """A step of the simulation did not converge, or the patch outgrew the pad."""
