"""Safe files: reads plain files within limits, writes files whole or not at all.

Every package may import it. It imports no other package of drupe.
"""
