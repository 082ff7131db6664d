"""Tracks for maps: GeoJSON (RFC 7946) and KML 2.2, of an estimate and its truth."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from ..files import written_whole
from .estimates import Estimates

Array = NDArray[np.float64]
Tracks = dict[str, tuple[Array, Array]]  # times (k,) and longitude, latitude, height (k, 3)

COLOURS = {"estimate": "ff b2 72 00", "truth": "ff c4 c4 c4"}  # KML's order: opaque, b, g, r
KML = "http://www.opengis.net/kml/2.2"


def geodetic_tracks(run: Estimates, rows: NDArray[np.int64]) -> Tracks | None:
    """Of the estimate and, where it is known, of the truth; None without a place on Earth.

    Args:
        rows: indices of the instants.
    """
    tracks: Tracks = {}
    for name, position in (("estimate", run.position), ("truth", run.truth)):
        if position is None:
            continue
        told = run.scenario.geodetic(position[rows])
        if told is None:
            return None
        known = np.isfinite(told).all(axis=1)
        tracks[name] = run.time[rows][known], told[known][:, [1, 0, 2]]
    return {name: track for name, track in tracks.items() if len(track[0]) > 1}


def write_geojson(tracks: Tracks, path: Path) -> None:
    """Write a feature per track: a line, its times beside it as ``times``, s."""
    features = [
        {
            "type": "Feature",
            "properties": {"name": name, "times": [float(f"{t:.12g}") for t in time]},
            "geometry": {"type": "LineString", "coordinates": _rounded(points)},
        }
        for name, (time, points) in tracks.items()
    ]
    with written_whole(path) as file:
        file.write(json.dumps({"type": "FeatureCollection", "features": features}).encode())


def write_kml(tracks: Tracks, path: Path) -> None:
    """Write a line per track, at its height."""
    root = ElementTree.Element("kml", xmlns=KML)
    document = ElementTree.SubElement(root, "Document")
    for name, (_, points) in tracks.items():
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
