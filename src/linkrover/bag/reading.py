"""`read_recording`: one recording, whatever its container and however damaged."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import msgspec

from linkrover.errors import LinkRoverError, ParseError
from linkrover.records import Manifest, Record

from .blocks import Block, Problems, Topic
from .interpret import Interpreter, interpreter
from .mcap_read import McapFile
from .patterns import DEFAULT_PATTERNS, Meaning, TopicPattern, meanings
from .recorder import JOURNAL_SUFFIX
from .ros1_read import Ros1File

_SUFFIXES = (".mcap", ".bag", JOURNAL_SUFFIX, ".bag.active")


class TopicSummary(msgspec.Struct, frozen=True):
    """A topic of a recording. record: the record its messages are read as, None = they are not read."""

    name: str
    type: str
    count: int
    first_ns: int
    last_ns: int
    record: str | None = None
    end: str | None = None


class Recording:
    """An opened recording. Iterating it streams: memory does not grow with its length."""

    def __init__(self, path: Path, files: Sequence[Path], patterns: Sequence[TopicPattern]) -> None:
        self.path = path
        self.files = tuple(files)
        self.manifest: Manifest | None = None
        self.topics: tuple[TopicSummary, ...] = ()
        self._patterns = patterns
        self._found = Problems()
        self._decoding = Problems()

    @property
    def format(self) -> str:
        """One of "mcap", "mcap journal" (not finished) and "ros1 bag"."""
        name = self.files[0].name
        return "mcap" if name.endswith(".mcap") else "mcap journal" if name.endswith(".journal") else "ros1 bag"

    @property
    def end(self) -> str:
        """The end that recorded: "robot", "station" or "truth"; of a bag that holds several, the one with most."""
        counts: dict[str, int] = {}
        for topic in self.topics:
            if topic.end is not None:
                counts[topic.end] = counts.get(topic.end, 0) + topic.count
        found = max(counts, key=lambda end: counts[end], default=None)
        return found or (self.manifest.role.value if self.manifest else "robot")

    @property
    def span(self) -> tuple[int, int] | None:
        """First and last message, wall clock ns; None if there is none."""
        times = [(t.first_ns, t.last_ns) for t in self.topics if t.count]
        return (min(first for first, _ in times), max(last for _, last in times)) if times else None

    @property
    def messages(self) -> int:
        """How many whole messages there are."""
        return sum(topic.count for topic in self.topics)

    @property
    def problems(self) -> tuple[str, ...]:
        """All that was damaged or missing; what cannot be decoded is known only after the records were read."""
        return tuple(self._found.all() + self._decoding.all())

    def records(self, *kinds: type[Record], end: str | None = None) -> Iterator[Record]:
        """The records in file order: of these kinds (none = all), of this end (None = all)."""
        for _, record in self.entries(*kinds, end=end):
            yield record

    def entries(self, *kinds: type[Record], end: str | None = None) -> Iterator[tuple[str, Record]]:
        """(end, record) in file order. A message that cannot be decoded is left out and counted in `problems`."""
        self._decoding = Problems()
        for file in self.files:
            container = open_container(file)
            readers: dict[int, Interpreter | None] = {}
            known = meanings(topics_of(container), self._patterns)
            for block in container.blocks():
                for raw in block.walk():
                    if raw.topic not in readers:
                        if raw.topic not in known and raw.topic in container.topics:
                            known = meanings(container.topics.values(), self._patterns)
                        readers[raw.topic] = self._reader(container.topics[raw.topic], known.get(raw.topic), kinds, end)
                    reader = readers[raw.topic]
                    if reader is None:
                        continue
                    try:
                        found = reader.records(memoryview(block.data)[raw.start : raw.end], raw.log_ns)
                    except ParseError:
                        self._decoding.count(f"messages on {reader.topic.name} cannot be decoded")
                        continue
                    for record in found:
                        if not kinds or isinstance(record, kinds):
                            yield reader.meaning.end, record

    def _reader(
        self, topic: Topic, meaning: Meaning | None, kinds: tuple[type[Record], ...], end: str | None
    ) -> Interpreter | None:
        if meaning is None or (end is not None and meaning.end != end):
            return None
        if kinds and meaning.kind not in kinds and topic.type != "network_analysis/NetworkAnalysis":
            return None
        found = interpreter(topic, meaning)
        if isinstance(found, LinkRoverError):
            self._decoding.add(f"{topic.name} cannot be read: {found}")
            return None
        return found

    def scan(self, progress: Callable[[float], None] | None = None) -> None:
        """Go through the whole file: topics, counts, times, what is damaged."""
        counts: dict[tuple[str, str], list[int]] = {}
        meant: dict[tuple[str, str], Meaning] = {}
        done, total = 0, sum(file.stat().st_size for file in self.files) or 1
        for file in self.files:
            container = open_container(file)
            base, size = done, 0
            for block in container.blocks():
                for topic_id, log_ns, number, last_ns in _times(block):
                    topic = container.topics.get(topic_id)
                    if topic is None:
                        continue
                    entry = counts.setdefault((topic.name, topic.type), [0, log_ns, last_ns])
                    entry[0] += number
                    entry[1] = min(entry[1], log_ns)
                    entry[2] = max(entry[2], last_ns)
                size += len(block.data)
                if progress is not None:
                    progress(min(1.0, (base + size) / max(total, base + size)))
            done += file.stat().st_size
            for topic_id, meaning in meanings(container.topics.values(), self._patterns).items():
                topic = container.topics[topic_id]
                meant[topic.name, topic.type] = meaning
            for topic in container.topics.values():
                counts.setdefault((topic.name, topic.type), [0, 0, 0])
            prefix = f"{file.name}: " if len(self.files) > 1 else ""
            for line in container.problems:
                self._found.add(prefix + line)
            self._manifest(container)
        self.topics = tuple(
            TopicSummary(
                name,
                kind,
                numbers[0],
                numbers[1],
                numbers[2],
                record=meant[name, kind].kind.__name__ if (name, kind) in meant else None,
                end=meant[name, kind].end if (name, kind) in meant else None,
            )
            for (name, kind), numbers in counts.items()
        )
        if self.manifest is None and any(t.record == "Manifest" for t in self.topics):
            self.manifest = next((r for r in self.records(Manifest) if isinstance(r, Manifest)), None)
        if self.path.is_dir():
            self._check_directory()

    def _manifest(self, container: McapFile | Ros1File) -> None:
        text = container.metadata.get("linkrover", {}).get("manifest")
        if text is not None and self.manifest is None:
            try:
                self.manifest = msgspec.json.decode(text, type=Manifest)
            except msgspec.MsgspecError as error:
                self._found.add(f"the manifest cannot be read: {error}")
        note = container.metadata.get("linkrover.recovery", {}).get("note")
        if note:
            self._found.add(note)

    def _check_directory(self) -> None:
        yaml = self.path / "metadata.yaml"
        if not yaml.is_file():
            if self.format == "mcap":
                self._found.add("metadata.yaml is missing")
            return
        try:
            text = yaml.read_text(encoding="utf-8", errors="replace")
        except OSError as error:
            self._found.add(f"metadata.yaml: {error.strerror}")
            return
        for name in re.findall(r"^\s*(?:- )?path: \"?([^\"\n]+)\"?\s*$", text, re.MULTILINE):
            if not (self.path / Path(name).name).is_file():
                self._found.add(f"{name} is named in metadata.yaml and is missing")


def _times(block: Block) -> Iterator[tuple[int, int, int, int]]:
    """(topic, first, number, last) of a block, from its index where it has one."""
    if block.index is None:
        for raw in block.walk():
            yield raw.topic, raw.log_ns, 1, raw.log_ns
        return
    for topic, entries in block.index.items():
        times = struct.unpack(f"<{len(entries) // 8}Q", entries)[::2]
        if times:
            yield topic, min(times), len(times), max(times)


def open_container(file: Path) -> McapFile | Ros1File:
    """The reader for a file, by its first bytes. Raises LinkRoverError."""
    try:
        with file.open("rb") as opened:
            head = opened.read(16)
    except OSError as error:
        raise LinkRoverError(f"{file}: {error.strerror}") from None
    if head.startswith(b"#ROSBAG"):
        return Ros1File(file)
    if head.startswith(b"SQLite format 3"):
        raise LinkRoverError(f"{file} is a rosbag2 sqlite3 file: convert it with 'ros2 bag convert' to mcap storage")
    if head.startswith(b"\x28\xb5\x2f\xfd"):
        raise LinkRoverError(f"{file} is compressed as a whole: unpack it with 'zstd -d'")
    return McapFile(file)


def topics_of(container: McapFile | Ros1File) -> list[Topic]:
    """Every topic of a file: from its summary, or by going through it."""
    if not container.read_summary():
        for block in container.blocks():
            if block.index is None:
                for _ in block.walk():
                    pass  # topics may be declared anywhere between the messages
    return list(container.topics.values())


def read_recording(
    path: Path,
    *,
    patterns: Sequence[TopicPattern] = DEFAULT_PATTERNS,
    progress: Callable[[float], None] | None = None,
) -> Recording:
    """Open one recording: a directory of ours or of rosbag2, an `.mcap`, a journal, or a ROS 1 `.bag`.

    patterns: which topics of others are what. progress is told the share that is read. Raises LinkRoverError if
    there is no recording; whatever is damaged is in `problems`.
    """
    files = recording_files(path)
    recording = Recording(path, files, patterns)
    recording.scan(progress)
    return recording


def read_manifest(path: Path) -> Manifest | None:
    """The manifest of a recording, without reading the rest of it where the file has it in its first part or its
    summary; None if it has none. Raises LinkRoverError.
    """
    for file in recording_files(path):
        container = open_container(file)
        if isinstance(container, Ros1File):
            continue
        container.read_summary()
        blocks: Iterator[Block] = iter(()) if "linkrover" in container.metadata else container.blocks()
        for _ in blocks:
            if "linkrover" in container.metadata:
                break
        text = container.metadata.get("linkrover", {}).get("manifest")
        if text is not None:
            try:
                return msgspec.json.decode(text, type=Manifest)
            except msgspec.MsgspecError:
                continue
    return None


def recording_files(path: Path) -> list[Path]:
    """The files of one recording. Raises LinkRoverError."""
    if not path.exists():
        raise LinkRoverError(f"{path} does not exist")
    if not path.is_dir():
        return [path]
    # rosbag2 numbers its parts: name_2 comes before name_10
    finished = sorted(path.glob("*.mcap"), key=lambda p: (len(p.name), p.name))
    journals = [j for j in sorted(path.glob(f"*{JOURNAL_SUFFIX}")) if not j.with_suffix("").exists()]
    bags = sorted(path.glob("*.bag")) + sorted(path.glob("*.bag.active"))
    if not finished + journals + bags:
        other = sorted(path.glob("*.db3"))
        if other:
            open_container(other[0])
        raise LinkRoverError(f"{path} holds no recording (*.mcap, *{JOURNAL_SUFFIX} or *.bag)")
    return finished or journals or bags[:1]


def find_recordings(path: Path) -> list[Path]:
    """The recordings of a run: of RUN its RUN/robot, RUN/station, RUN/truth; else the recording `path` itself is.

    Each can be given to `read_recording`. Raises LinkRoverError if there is none.
    """
    if not path.exists():
        raise LinkRoverError(f"{path} does not exist")
    if not path.is_dir():
        return [path]
    here = _in_directory(path)
    if here:
        return here
    found = [one for child in sorted(path.iterdir()) if child.is_dir() for one in _in_directory(child)]
    if not found:
        raise LinkRoverError(
            f"{path} holds no recording: give a run (a directory with robot/ and station/), a recording directory, "
            "an .mcap or a .bag"
        )
    order = {"robot": 0, "station": 1, "truth": 2}
    return sorted(found, key=lambda p: (order.get(p.name, 3), p.name))


def _in_directory(path: Path) -> list[Path]:
    names = sorted(p for p in path.iterdir() if p.name.endswith(_SUFFIXES) and p.is_file())
    bags = [p for p in names if ".bag" in p.suffixes[-2:] or p.suffix == ".bag"]
    mcaps = [p for p in names if p not in bags]
    if not mcaps:
        return bags
    stems = {p.name.removesuffix(".journal") for p in mcaps}
    if (path / "metadata.yaml").is_file() or len(stems) == 1:
        return [path, *bags]
    return [*mcaps, *bags]
