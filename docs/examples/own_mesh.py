"""What pcnav takes for a target, and in which unit. Needs satellite.stl, in millimetres."""

import trimesh

import pcnav

print(pcnav.Target.from_mesh("satellite.stl", unit="mm"))

mesh = trimesh.load_mesh("satellite.stl")
mesh.apply_scale(1e-3)
from_trimesh = pcnav.Target.from_mesh(mesh, name="mine")  # metres unless told
from_arrays = pcnav.Target.from_mesh((mesh.vertices, mesh.faces), unit="m")
shipped = pcnav.Target.from_mesh("cubesat6u")

for target in (from_trimesh, from_arrays, shipped):
    print(target)
    print("  mass centre of a uniform body", target.com_model, "m, model frame")
