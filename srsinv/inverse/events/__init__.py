"""Detection of contact events in a stream of samples: a threshold, and matched filters."""
