"""Synthetic fruit with known answers, by a discretisation and solver that the estimator does not use.

Only the sparse solver comes from fem: a truth from the estimator's code would hide the errors of that code.
"""
