"""What only some recordings can tell: the radio's peers and neighbours, topics and connections, the cost."""

from __future__ import annotations

from linkrover.analysis.summary import RunSummary

from .air import air_section
from .cost import cost_section
from .section import Section
from .traffic import traffic_section


def detail_sections(summary: RunSummary) -> list[Section]:
    """Those sections that have something to say."""
    return [section for make in (air_section, traffic_section, cost_section) if (section := make(summary))]
