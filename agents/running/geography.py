"""Tracks for maps: GeoJSON (RFC 7946) and KML 2.2, of an estimate and its truth."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from ..files import written_whole
from .estimates import Estimates

Array = NDArray[np.float64]
Track = tuple[str, Array, Array]  # name, times (k,) and longitude, latitude, height (k, 3)

COLOURS = {"estimate": "ff b2 72 00", "truth": "ff c4 c4 c4"}  # KML's order: opaque, b, g, r
KML = "http://www.opengis.net/kml/2.2"


def geodetic_tracks(run: Estimates, rows: NDArray[np.int64]) -> list[Track]:
    """Each stretch of the estimate and, where it is known, the truth; none without a place.

    Args:
        rows: indices of the instants.
    """
    if not run.has_position:
        return []
    parts = [("estimate", run.position, rows[part]) for part in run.stretches(rows)]
    tracks: list[Track] = []
    for name, position, part in (*parts, ("truth", run.true_position, rows)):
        part = part[np.isfinite(position[part]).all(axis=1)]
        told = run.scenario.geodetic(position[part])
        if told is not None and len(part) > 1:
            tracks.append((name, run.time[part], told[:, [1, 0, 2]]))
    return tracks


def write_geojson(tracks: Sequence[Track], path: Path) -> None:
    """Write a feature per track: a line, its times beside it as ``times``, s."""
    features = [
        {
            "type": "Feature",
            "properties": {"name": name, "times": [float(f"{t:.12g}") for t in time]},
            "geometry": {"type": "LineString", "coordinates": _rounded(points)},
        }
        for name, time, points in tracks
    ]
    with written_whole(path) as file:
        file.write(json.dumps({"type": "FeatureCollection", "features": features}).encode())


def write_kml(tracks: Sequence[Track], path: Path) -> None:
    """Write a line per track, at its height."""
    root = ElementTree.Element("kml", xmlns=KML)
    document = ElementTree.SubElement(root, "Document")
    for name, _, points in tracks:
        placemark = ElementTree.SubElement(document, "Placemark")
        ElementTree.SubElement(placemark, "name").text = name
        style = ElementTree.SubElement(ElementTree.SubElement(placemark, "Style"), "LineStyle")
        ElementTree.SubElement(style, "color").text = COLOURS[name].replace(" ", "")
        ElementTree.SubElement(style, "width").text = "3"
        line = ElementTree.SubElement(placemark, "LineString")
        ElementTree.SubElement(line, "altitudeMode").text = "absolute"
        ElementTree.SubElement(line, "coordinates").text = " ".join(
            ",".join(f"{number:.10g}" for number in point) for point in _rounded(points)
        )
    with written_whole(path) as file:
        ElementTree.ElementTree(root).write(file, encoding="UTF-8", xml_declaration=True)


def _rounded(points: Array) -> list[list[float]]:
    """To a millimetre or so."""
    return [[round(a, 8), round(b, 8), round(c, 3)] for a, b, c in points.tolist()]
