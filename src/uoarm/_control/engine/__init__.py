"""What the manager decides, without I/O: `step(state, event, now) -> (state, actions)`."""
