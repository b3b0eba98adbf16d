"""The host's side: it runs bridges and answers what the manager asks of them."""
