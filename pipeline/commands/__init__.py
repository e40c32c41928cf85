"""The commands of `drupe`, one file each: arguments, output and exit status."""
