"""How many examples Hypothesis tries: few by default, ``HYPOTHESIS_PROFILE=long`` for a search."""

from __future__ import annotations

import os

from hypothesis import HealthCheck, settings

IS_LONG = os.environ.get("HYPOTHESIS_PROFILE") == "long"
"""Whether properties are tried at length."""


def load_profile(short: int, long: int | None = None, *suppressed: HealthCheck) -> None:
    """Have every property tried so often from now on.

    Args:
        short: examples, the same every time.
        long: of the search, which looks further; None: as `short`.
        suppressed: checks of Hypothesis left out; that of slow examples is always, since they are
            no fault of what is drawn on a machine with other work.
    """
    name = os.environ.get("HYPOTHESIS_PROFILE", "short")
    is_long = IS_LONG and long is not None
    settings.register_profile(
        name,
        max_examples=long if is_long else short,
        deadline=None,
        suppress_health_check=(HealthCheck.too_slow, *suppressed),
        derandomize=not is_long,
    )
    settings.load_profile(name)
