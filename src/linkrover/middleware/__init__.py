"""What LinkRover asks of a robot's middleware, and what is the same for all of them."""

from .delay import DelayProber, NearestRtt
from .protocol import Answer, Fields, Graph, Middleware, Pinger, TopicInfo
from .sink import Layout, RecordPublisher

__all__ = [
    "Answer",
    "DelayProber",
    "Fields",
    "Graph",
    "Layout",
    "Middleware",
    "NearestRtt",
    "Pinger",
    "RecordPublisher",
    "TopicInfo",
]
