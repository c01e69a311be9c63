"""The true mass properties of a scenario that does not state them: the nominal ones of its mesh."""

from pathlib import Path

from pcnav.config.pipeline_file import Pipeline
from pcnav.target.satellite import nominal_mass


def with_nominal_body(pipeline: Pipeline, mesh_path: Path | None) -> Pipeline:
    """A pipeline whose [body] states mass centre and inertia, if there is a mesh to take them of.

    Raises `InputError` for a mesh or a sidecar that cannot be read.
    """
    body = pipeline.body
    if mesh_path is None or (body.com_model_m is not None and body.inertia_ratios is not None):
        return pipeline
    mass = nominal_mass(mesh_path, pipeline.mesh_unit)
    nominal = {
        "com_model_m": tuple(float(x) for x in mass.com_model),
        "inertia_ratios": tuple(float(x) for x in mass.inertia_ratios),
    }
    # What is stated stays.
    nominal |= {key: value for key in nominal if (value := getattr(body, key)) is not None}
    return pipeline.model_copy(update={"body": body.model_copy(update=nominal)})
