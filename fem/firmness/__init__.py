"""Standard tests of firmness, simulated on each fruit's own mesh, for `drupe firmness`."""
