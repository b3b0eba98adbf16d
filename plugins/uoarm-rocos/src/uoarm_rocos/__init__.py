"""uoarm-rocos: devices and robots with an XML catalogue as components of uoarm."""
