"""Whether a path may be run: reach, joints, singularities, correction, stock, spindle."""
