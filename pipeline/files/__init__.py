"""Files written whole or not at all, only where they may be, by one run at a time."""
