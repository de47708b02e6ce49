"""The file formats: C, Rust, MATLAB, MJCF, URDF, LaTeX and JSON."""
