"""Learning tests compile each program once, also across processes, as the product does."""

import pytest


@pytest.fixture(scope="session", autouse=True)
def cache(tmp_path_factory):
    import jax

    folder = str(tmp_path_factory.mktemp("compiled"))
    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = [getattr(jax.config, name) for name in names]
    for name, value in zip(names, (folder, 0.2), strict=True):
        jax.config.update(name, value)
    yield folder
    for name, value in zip(names, before, strict=True):
        jax.config.update(name, value)
