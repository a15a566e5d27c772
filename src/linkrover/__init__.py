"""LinkRover: measures a mobile robot's Wi-Fi link at both ends while it drives."""

__version__ = "0.1.0"
