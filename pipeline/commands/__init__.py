"""The commands of `drupe`, one file each: what is asked for, and how it ends."""
