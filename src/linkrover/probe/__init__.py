"""STAMP probes (RFC 8762): sender, reflector, clock offset, and what a series of results says."""
