"""Recordings: what functions give, in MCAP files, and those files as components again.

Needs the extra `record`, once something is recorded or read.
"""

from typing import TYPE_CHECKING

from uoarm._deferred import deferred

if TYPE_CHECKING:
    from uoarm.record._checking import (
        ChannelCheck,
        ConsumerCheck,
        FailedMessage,
        RecordingCheck,
        check_recording,
    )
    from uoarm.record._options import RecordedChannel, RecordingStatus, RecordOptions
    from uoarm.record._playback import PlaybackStatus, ask_playback
    from uoarm.record._recording import Recording

__all__ = [
    "ChannelCheck",
    "ConsumerCheck",
    "FailedMessage",
    "PlaybackStatus",
    "RecordOptions",
    "RecordedChannel",
    "Recording",
    "RecordingCheck",
    "RecordingStatus",
    "ask_playback",
    "check_recording",
]

if not TYPE_CHECKING:
    __getattr__, __dir__ = deferred(
        __name__,
        {
            "_checking": (
                "ChannelCheck",
                "ConsumerCheck",
                "FailedMessage",
                "RecordingCheck",
                "check_recording",
            ),
            "_options": ("RecordOptions", "RecordedChannel", "RecordingStatus"),
            "_playback": ("PlaybackStatus", "ask_playback"),
            "_recording": ("Recording",),
        },
    )
