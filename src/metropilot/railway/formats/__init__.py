"""Readers and writers of lines, trainsets and journeys."""
