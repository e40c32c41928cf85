"""Place, time and component of a mismatch: maps, analysis of variance, spot search."""
