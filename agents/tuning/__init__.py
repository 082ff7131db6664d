"""Static noise and classical rules from a log, with intervals, and a report on the innovations."""
