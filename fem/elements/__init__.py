"""Quadratic elements: shape functions and quadrature of T10 and T6, assembly of stiffness matrices."""
