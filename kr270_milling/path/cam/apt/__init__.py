"""APT source and CL text as Creo, NX and other CAM systems write it."""
