"""Recordings: the recorder (rosbag2 MCAP, crash-safe), and readers of ours, rosbag2's and ROS 1's.

`linkrover.bag.frames` reads the same as data frames; it needs the `report` extra and is not imported here.
"""

from .patterns import DEFAULT_PATTERNS, TopicPattern, load_patterns
from .reading import Recording, TopicSummary, find_recordings, read_recording
from .recorder import Recorder, is_live, recover

__all__ = [
    "DEFAULT_PATTERNS",
    "Recorder",
    "Recording",
    "TopicPattern",
    "TopicSummary",
    "find_recordings",
    "is_live",
    "load_patterns",
    "read_recording",
    "recover",
]
