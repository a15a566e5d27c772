"""Load on the link with the other end's consent, and what the probes feel of it (loaded latency, RFC 6349)."""
