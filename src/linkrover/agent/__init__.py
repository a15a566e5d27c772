"""The process that measures at one end: configuration, schedule, probes, feed, self-accounting."""

from .agent import Agent, Part
from .config import AgentConfig, Outage, Probe, Rates, Reflector, load_config, parse_config
from .feed import FeedSender
from .sink import CountingSink, Sink

__all__ = [
    "Agent",
    "AgentConfig",
    "CountingSink",
    "FeedSender",
    "Outage",
    "Part",
    "Probe",
    "Rates",
    "Reflector",
    "Sink",
    "load_config",
    "parse_config",
]
