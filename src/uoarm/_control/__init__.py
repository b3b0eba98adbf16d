"""The control plane: requests, connections, what is shared between them, and their status."""
