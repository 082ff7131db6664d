"""Times as logs write them, in seconds: numbers, times of day, dates with times."""

from __future__ import annotations

import re
from datetime import UTC, datetime

TIME_OF_DAY = re.compile(r"(\d{1,2}):([0-5]\d):([0-5]\d(?:[.,]\d+)?)")
DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]")


def seconds(text: str) -> float:
    """Seconds that a number, ``12:34:56.7`` (of the day) or an ISO 8601 date and time tells.

    A date and time counts from 1970 (UTC); one without a zone is taken as UTC.

    Raises:
        ValueError: if it is none of these.
    """
    text = text.strip()
    day = TIME_OF_DAY.fullmatch(text)
    if day is not None:
        hour, minute, second = day.groups()
        return 3600.0 * int(hour) + 60.0 * int(minute) + float(second.replace(",", "."))
    if DATE.match(text) is None:
        return float(text)
    told = datetime.fromisoformat(text)
    told = told.replace(tzinfo=UTC) if told.tzinfo is None else told
    since = told - datetime(1970, 1, 1, tzinfo=UTC)
    return 86_400.0 * since.days + since.seconds + 1e-6 * since.microseconds
