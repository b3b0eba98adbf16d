"""The bridges of one manager: started, in hosts and on machines, too, restarted and let go."""
