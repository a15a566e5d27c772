"""Recordings: the recorder (rosbag2 MCAP, crash-safe), and readers of ours, rosbag2's and ROS 1's."""

from .recorder import Recorder, is_live, recover

__all__ = ["Recorder", "is_live", "recover"]
