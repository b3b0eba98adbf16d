"""What does the reconciler's work: one thread for its state, lanes for its actions, one timer."""
