"""The published 2021 measurements, turned into ordinary recordings."""
