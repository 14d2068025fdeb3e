"""Ground floor: parameter records and files, output files, frames, errors."""
