"""What both ends of a host share: requests, flows, counters, liveness and security over Zenoh."""
