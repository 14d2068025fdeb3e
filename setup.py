"""Parts of the package that ament needs; the metadata are in pyproject.toml."""

from glob import glob

from setuptools import setup

setup(
    # two metadata are here and not there: with the setuptools of Ubuntu 24.04 (68) colcon reads no python_requires from
    # pyproject.toml, and the expression of a licence is refused
    python_requires=">=3.10",
    license="Apache-2.0",
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/kr270_milling"]),
        ("share/kr270_milling", ["package.xml"]),
        ("share/kr270_milling/config", sorted(glob("config/*"))),
    ],
)
