"""The application: batches in, ranking and report out; the only room that knows all the others."""
