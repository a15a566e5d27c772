"""What LinkRover asks of a robot's middleware, and what is the same for all of them."""

from .delay import DelayProber, NearestRtt
from .protocol import Answer, Graph, Middleware, Pinger, TopicInfo

__all__ = ["Answer", "DelayProber", "Graph", "Middleware", "NearestRtt", "Pinger", "TopicInfo"]
