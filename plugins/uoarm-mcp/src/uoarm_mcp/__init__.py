"""The functions of a robot as tools and resources of the Model Context Protocol, for agents.

What moves something is done with the approval of a person only; see `docs/agents.md`.
"""
