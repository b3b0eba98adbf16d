"""The manager's side of hosts on other machines: which are there, and the bridges taken up."""
