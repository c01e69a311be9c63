"""What a shell completes beside commands, options and files."""


def pipelines(incomplete: str) -> list[str]:
    """Names of shipped pipelines."""
    from pcnav.config.shipped import shipped_pipeline_names

    return _of(shipped_pipeline_names(), incomplete)


def meshes(incomplete: str) -> list[str]:
    """Names of shipped satellites."""
    from pcnav.config.shipped import shipped_mesh_names

    return _of(shipped_mesh_names(), incomplete)


def estimators(incomplete: str) -> list[str]:
    """Names of estimators."""
    from pcnav.estimators.registry import ESTIMATORS

    return _of(tuple(ESTIMATORS), incomplete)


def _of(names: tuple[str, ...], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]
