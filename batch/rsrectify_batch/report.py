# SPDX-License-Identifier: MIT OR Apache-2.0

"""A page over all clips of a run: what was done with each, in numbers."""

import os
from html import escape
from pathlib import Path
from string import Template
from typing import Any
from urllib.parse import quote

from . import manifest

NAME = "rsrectify-batch.html"
# Ends the folder of a clip's own page, beside its result: what `rsrectify show CLIP --html` is to be given.
PAGE = ".page"

TEMPLATE = Template("""<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<link rel="icon" href="data:,">
<title>$title</title>
<style>
body { margin: 12px; font: 15px/1.4 system-ui, sans-serif; }
div { overflow-x: auto; }
table { border-collapse: collapse; }
th, td { padding: 4px 10px; text-align: left; vertical-align: top; border-bottom: 1px solid #8886; }
td.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
tr.failed td { color: #c33; }
</style>
<h1>$title</h1>
<p>$count</p>
<div><table>
<tr>$head</tr>
$rows
</table></div>
""")

# What a column shows of a clip, and whether it is a number.
COLUMNS = {
    "clip": False,
    "state": False,
    "frames": True,
    "readout": False,
    "corrected, %": True,
    "largest correction, px": True,
    "confidence": True,
    "as recorded": False,
    "seconds": True,
    "page": False,
}


def write(folder: Path) -> Path:
    """Writes the page of a run into the folder that it writes to; the page's path."""
    clips = manifest.read(folder)["clips"]
    done = sum(known["state"] == "done" for known in clips.values())
    title = f"Clips in {folder.resolve().name}"
    page = TEMPLATE.substitute(
        title=escape(title),
        count=f"{done} of {len(clips)} clips rectified",
        head="".join(f"<th>{escape(column)}" for column in COLUMNS),
        rows="\n".join(_row(folder.resolve(), clip, known) for clip, known in clips.items()),
    )
    path = folder / NAME
    unfinished = path.with_suffix(".part")
    unfinished.write_text(page, encoding="utf-8")
    os.replace(unfinished, path)
    return path


def numbers(known: dict[str, Any]) -> dict[str, Any]:
    """What is known of the correction of a clip, over the parts that are rectified so far: `corrected`, a share, `largest` in
    pixels, `confidence`, the least of the parts' medians, the longest stretch `as_recorded`, and the `seconds` of all workers."""
    results = [part["result"] for part in known.get("parts", []) if "result" in part] or [known.get("result", {})]
    summaries = [result["summary"] for result in results if "summary" in result]
    if not summaries:
        return {}
    frames = sum(one["frames"] for one in summaries)
    corrections = [one["correction_px"]["largest"] for one in summaries if one["correction_px"]]
    confidences = [one["confidence"] for one in summaries if one["confidence"] is not None]
    stretches = [one["as_recorded"] for one in summaries if one["as_recorded"]]
    return {
        "corrected": sum(one["corrected_frames"] for one in summaries) / max(frames, 1),
        "largest": max(corrections, default=None),
        "confidence": min(confidences, default=None),
        "as_recorded": max(stretches, key=lambda one: one["frames"], default=None),
        "seconds": sum(result["seconds"] for result in results),
        "readout": summaries[0]["readout"],
    }


def _row(folder: Path, clip: str, known: dict[str, Any]) -> str:
    found = numbers(known)
    output = Path(known["output"])
    page = output.with_name(Path(clip).name + PAGE) / "index.html"
    stretch = found.get("as_recorded")
    cells = {
        "clip": _link(folder, output, clip) if known["state"] == "done" else escape(clip),
        "state": escape(known["state"] + (f": {known['error']}" if "error" in known else "")),
        "frames": _number(known.get("index", {}).get("frames"), "{:d}"),
        "readout": escape(_readout(known, found)),
        "corrected, %": _number(found.get("corrected"), "{:.0%}").rstrip("%"),
        "largest correction, px": _number(found.get("largest"), "{:.1f}"),
        "confidence": _number(found.get("confidence"), "{:.2f}"),
        "as recorded": escape(f"{stretch['duration_s']:.2f} s: {stretch['reason']}" if stretch else ""),
        "seconds": _number(found.get("seconds"), "{:.1f}"),
        "page": _link(folder, page, "before and after") if page.exists() else "",
    }
    text = "".join(
        f'<td class="number">{cells[column]}' if is_number else f"<td>{cells[column]}"
        for column, is_number in COLUMNS.items()
    )
    return f'<tr class="failed">{text}' if known["state"] == "failed" else f"<tr>{text}"


def _readout(known: dict[str, Any], found: dict[str, Any]) -> str:
    """That of the whole clip, where one was found or given."""
    if "readout" in known:
        return str(known["readout"]["said"])
    readout = found.get("readout", {})
    if readout.get("signed_ms") is None:
        return ""
    return f"{readout['signed_ms']:.1f} ms, {readout['direction']}, as given"


def _number(value: float | None, form: str) -> str:
    return "" if value is None else form.format(value)


def _link(folder: Path, target: Path, text: str) -> str:
    """A link that stays right where the folder is moved."""
    return f'<a href="{escape(quote(os.path.relpath(target, folder)))}">{escape(text)}</a>'
