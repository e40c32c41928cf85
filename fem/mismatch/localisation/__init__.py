"""Where, when and in which component a mismatch sits: maps, analysis of variance, spot search."""
