"""Versions of uploads in the store: one hand wins, and folders of earlier servers have a first version."""

import sqlite3
from concurrent.futures import ThreadPoolExecutor

import pytest

from metropilot.web.errors import Refused
from metropilot.web.store import JobStore


def test_of_many_hands_at_one_version_one_saves(tmp_path):
    store = JobStore(tmp_path)
    key = store.add_upload("line", "mine", "0.toml").id

    def save(k):
        try:
            return JobStore(tmp_path).add_version(key, 1, f"of {k}", f"{k}.toml")
        except Refused as error:
            return error.status

    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(save, range(1, 17)))
    assert sorted(found) == [2] + [409] * 15
    newest, first = store.versions(key)
    assert (newest.number, first.number) == (2, 1)
    assert store.uploads("line")[0].file == newest.file == f"{found.index(2) + 1}.toml"
    with pytest.raises(Refused, match="no such upload"):
        store.add_version("upload-none", 1, "mine", "2.toml")


def test_a_folder_without_versions_has_first_ones(tmp_path):
    key = JobStore(tmp_path).add_upload("line", "mine", "0.toml").id
    with sqlite3.connect(tmp_path / "console.sqlite") as database:
        database.execute("DROP TABLE versions")
    store = JobStore(tmp_path)
    assert [(row.number, row.file) for row in store.versions(key)] == [(1, "0.toml")]
    assert store.add_version(key, 1, "mine", "1.toml") == 2
    assert len(JobStore(tmp_path).versions(key)) == 2
