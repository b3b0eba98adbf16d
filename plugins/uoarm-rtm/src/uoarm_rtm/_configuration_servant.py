"""Configuration sets of our own component: named sets of strings, one of them active."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

from _uoarm_rtm_stubs import SDOPackage, SDOPackage__POA

from uoarm_rtm._orb import Orb
from uoarm_rtm._peer import pairs, properties_of

__all__ = ["ConfigurationServant"]

_MOST_SETS = 100


class ConfigurationServant(SDOPackage__POA.Configuration):  # type: ignore[misc]  # generated
    """Device profiles, service profiles and organisations are refused: we have none.

    Args:
        orb: where it is served.
        sets: values by name of the set.
        changed: called with the values in force whenever they change, in a thread of the ORB.
    """

    def __init__(
        self,
        orb: Orb,
        sets: Mapping[str, Mapping[str, str]],
        changed: Callable[[Mapping[str, str]], None],
    ) -> None:
        self._orb = orb
        self._changed = changed
        # Guards the sets and which is active: operations come in threads of the ORB.
        self._lock = threading.Lock()
        self._sets = {name: dict(values) for name, values in sets.items()}
        self._sets.setdefault("default", {})
        self._active = "default"
        self.reference = orb.serve(self)

    def close(self) -> None:
        """Stop serving."""
        self._orb.withdraw(self.reference)

    def get_configuration_sets(self) -> list[Any]:
        """Return every set (CORBA operation)."""
        return [self._set(name) for name in list(self._sets)]

    def get_configuration_set(self, config_id: str) -> Any:
        """Return one set (CORBA operation)."""
        if config_id not in self._sets:
            raise SDOPackage.InternalError(f"there is no configuration set {config_id!r}")
        return self._set(config_id)

    def get_active_configuration_set(self) -> Any:
        """Return the set in force (CORBA operation)."""
        return self._set(self._active)

    def activate_configuration_set(self, config_id: str) -> bool:
        """Put a set in force (CORBA operation)."""
        with self._lock:
            if config_id not in self._sets:
                raise SDOPackage.InvalidParameter(f"there is no configuration set {config_id!r}")
            self._active = config_id
        self._notify()
        return True

    def set_configuration_set_values(self, configuration_set: Any) -> bool:
        """Replace values of a set (CORBA operation)."""
        with self._lock:
            if configuration_set.id not in self._sets:
                text = f"there is no configuration set {configuration_set.id!r}"
                raise SDOPackage.InvalidParameter(text)
            values = properties_of(configuration_set.configuration_data)
            self._sets[configuration_set.id].update(values)
            in_force = configuration_set.id == self._active
        if in_force:
            self._notify()
        return True

    def add_configuration_set(self, configuration_set: Any) -> bool:
        """Add a set (CORBA operation)."""
        with self._lock:
            if configuration_set.id in self._sets or len(self._sets) >= _MOST_SETS:
                raise SDOPackage.InvalidParameter("it is there already, or there are too many")
            values = properties_of(configuration_set.configuration_data)
            self._sets[configuration_set.id] = values
        return True

    def remove_configuration_set(self, config_id: str) -> bool:
        """Remove a set that is not in force (CORBA operation)."""
        with self._lock:
            if config_id == self._active or self._sets.pop(config_id, None) is None:
                raise SDOPackage.InvalidParameter("it is in force, or not there")
        return True

    def get_configuration_parameters(self) -> list[Any]:
        """Return nothing: types of parameters are not declared (CORBA operation)."""
        return []

    def get_configuration_parameter_values(self) -> list[Any]:
        """Return the values in force (CORBA operation)."""
        return pairs(self._sets[self._active])

    def _set(self, name: str) -> Any:
        return SDOPackage.ConfigurationSet(name, "", pairs(self._sets[name]))

    def _notify(self) -> None:
        self._changed(dict(self._sets[self._active]))
