"""What a recovered copy of a log says of itself: the second metadata record of its file, behind the log's own.

``recovery.py`` writes it and ``judge.py`` holds the file to it: a log that has it is the copy of what a crash has left,
and never OK. It stands before the first chunk, so that what is left of a copy that was cut says so as well.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from mcap.records import Metadata

RECOVERED: Final = "cutgate.recovered"
_KEYS: Final = ("original", "original_sha256", "original_bytes", "dropped_bytes", "records", "software")
_DIGEST: Final = re.compile(r"[0-9a-f]{64}")
_NUMBER: Final = re.compile(r"0|[1-9][0-9]{0,18}")
TEXT_MAX: Final = 2000
"""Characters of a name of a file, with what is no text in it escaped; a file system has 255 bytes."""


@dataclass(frozen=True, slots=True)
class Recovered:
    """Of what a copy was made, and how much of it is there.

    Attributes:
        original: name of the log's file, without its folder.
        sha256: of all its bytes, hex.
        size: of it, bytes.
        dropped: bytes at its end that are no whole record.
        records: what the copy holds of it, from record 0 on.
        software: what made the copy.
    """

    original: str
    sha256: str
    size: int
    dropped: int
    records: int
    software: str

    def metadata(self) -> Metadata:
        """As it stands in the file."""
        content = {
            "original": self.original,
            "original_sha256": self.sha256,
            "original_bytes": str(self.size),
            "dropped_bytes": str(self.dropped),
            "records": str(self.records),
            "software": self.software,
        }
        return Metadata(RECOVERED, content)

    @classmethod
    def parse(cls, content: Mapping[str, str]) -> "Recovered":
        """From what stands in the file.

        Raises:
            ValueError: no recovery writes this.
        """
        if tuple(content) != _KEYS:
            raise ValueError(f"its keys are not {', '.join(_KEYS)}")
        original, digest, *numbers, software = content.values()
        if not (_DIGEST.fullmatch(digest) and all(map(_NUMBER.fullmatch, numbers))):
            raise ValueError("what must be a SHA-256 or a number is none")
        if not all(0 < len(text) <= TEXT_MAX for text in (original, software)):
            raise ValueError("a name is empty or longer than any")
        size, dropped, records = map(int, numbers)
        if not dropped <= size:
            raise ValueError(f"it drops {dropped} bytes of {size}")
        return cls(original, digest, size, dropped, records, software)

    def __str__(self) -> str:
        """What is said of the copy."""
        return f"it is a recovered copy of {self.original}, {self.dropped} bytes dropped"


def told_by(entries: Iterable[Metadata]) -> Recovered | None:
    """What the metadata of a file say of a recovery; None if they say nothing.

    Raises:
        ValueError: what they say is nothing that a recovery writes.
    """
    found = next((entry for entry in entries if entry.name == RECOVERED), None)
    return None if found is None else Recovered.parse(found.metadata)


def is_copy(entries: Iterable[Metadata]) -> bool:
    """Whether the metadata of a file say that it is a recovered copy, be it in words that no recovery writes."""
    return any(entry.name == RECOVERED for entry in entries)
