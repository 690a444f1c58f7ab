#!/usr/bin/env python3
"""rerun_recording.py FILE.mcap FOLDER: converts a recording for Rerun, and accounts for every channel.

Exit code 1 where a channel with messages has fewer rows in Rerun than messages in the file.
"""

import os
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

from mcap.reader import make_reader

SCRIPT = Path(__file__).resolve().parents[2] / "docs/viewers/rerun_view.py"


def rows_of(recording):
    """Rows by entity, without those that describe the channel itself."""
    printed = subprocess.run(["rerun", "rrd", "print", str(recording)], check=True, capture_output=True, text=True)
    rows = Counter()
    for count, entity, columns in re.findall(r"with (\d+) rows .*? - (\S+) - .*?columns: \[(.*?)\]", printed.stdout):
        if "McapChannel:id" not in columns:
            rows[entity.lstrip("/")] += int(count)
    return rows


def main(path, folder):
    # Rerun's program lies beside this Python.
    os.environ["PATH"] = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    subprocess.run([sys.executable, str(SCRIPT), path, "--save", folder], check=True)
    rows = rows_of(Path(folder) / "vitreo.rrd")
    with open(path, "rb") as file:
        summary = make_reader(file).get_summary()
    counts = summary.statistics.channel_message_counts
    wrong = 0
    for channel in summary.channels.values():
        messages = counts.get(channel.id, 0)
        if messages == 0:
            continue
        topic = channel.topic.lstrip("/")
        found = rows[topic]
        wrong += found < messages
        print(f"{channel.topic:<22} {messages:>7} messages {found:>7} rows{'' if found >= messages else '  MISSING'}")
    if not counts or wrong:
        raise SystemExit(f"rerun_recording: {wrong} channels are not accounted for")
    if (Path(folder) / "vitreo.rbl").stat().st_size == 0:
        raise SystemExit("rerun_recording: the layout is empty")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        raise SystemExit("usage: rerun_recording.py FILE.mcap FOLDER")
    main(sys.argv[1], sys.argv[2])
