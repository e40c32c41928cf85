"""Synthetic fruit with known answers, by a discretisation and solver of their own.

Nothing of fem is used: a truth made by the estimator's code would share its errors and hide them.
"""
