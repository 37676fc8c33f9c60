"""The noise of recorded signals, and signals of no interest beside it."""
