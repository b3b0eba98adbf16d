"""The bridges of one manager: which run, when one is started again, and who of other machines."""

from uoarm._bridges._bridge_set import BridgeSet, Restarts, StagedBridges, close_logged, facts_of

__all__ = ["BridgeSet", "Restarts", "StagedBridges", "close_logged", "facts_of"]
