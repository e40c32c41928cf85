"""What to record next: candidate grasps, what each explanation predicts of them, expected evidence."""
