"""A sparse direct solver: elimination order, multifrontal Cholesky, condensed compliance."""
