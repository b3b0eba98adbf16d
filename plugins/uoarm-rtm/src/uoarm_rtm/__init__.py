"""uoarm-rtm: OpenRTM components as components of uoarm, over real CORBA.

Importing this package imports no middleware; making a bridge does.
"""
