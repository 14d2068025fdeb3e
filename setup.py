from glob import glob

from setuptools import find_packages, setup

package = "kr270_milling"
nodes = ["compliant_robot", "cutting_process", "trajectory_compensator", "recorder", "player", "milling_cell"]

setup(
    name=package,
    version="0.4.0",
    packages=find_packages(include=[package, package + ".*"]),
    package_data={
        package: [
            "py.typed",
            "cell/draft.yaml",
            "decide/programs/*.txt",
            "show/report/page/*.html",
            "show/report/page/*.css",
            "show/report/page/*.js",
            "show/report/page/*.txt",
        ]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package]),
        ("share/" + package, ["package.xml"]),
        ("share/" + package + "/config", sorted(glob("config/*"))),
    ],
    python_requires=">=3.10",
    install_requires=[
        "numpy>=1.24",
        "scipy>=1.10",
        "numba>=0.59,<0.69",
        "mcap>=1.6",
        "rosbags>=0.11",
        "PyYAML>=6.0",
        "plotly>=6.0",
        "Jinja2>=3.1",
        "rich>=13.0",
    ],
    extras_require={
        "studies": ["dask[distributed]>=2024.1", "pyarrow>=14", "pandas>=2.0"],
        "ros": ["ros-jazzy-rclpy[fastrtps]==7.1.6", "ros-jazzy-common-interfaces==5.3.6"],
        "completion": ["argcomplete>=3.0"],
        "uff": ["pyuff>=2.4"],
        "docs": ["sphinx>=7.4"],
        "test": [
            "dask[distributed]>=2024.1",
            "pyarrow>=14",
            "pandas>=2.0",
            "psutil>=5.9",
            "pyuff>=2.4",
            "jsonschema>=4.20",
            "nbclient>=0.10",
            "ipykernel>=6.29",
            "pytest>=7.4",
            "setuptools>=64",
            "wheel",
            "pytest-xdist>=3.5",
            "hypothesis>=6.80",
            "pin>=2.7",
            "playwright>=1.40",
            "argcomplete>=3.0",
            "mcap-ros2-support>=0.5",
            "sphinx>=7.4",
            "mypy>=1.13",
            "types-PyYAML",
            "ruff>=0.6",
            "import-linter>=2.6",
        ],
    },
    zip_safe=False,
    maintainer="kr270_milling maintainers",
    maintainer_email="kr270-milling@users.noreply.github.com",
    description="Predict and compensate the compliance errors of robotic milling (KUKA KR 270), as ROS 2 nodes.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": ["kr270_milling = kr270_milling.__main__:run_program"]
        + [f"{node} = kr270_milling.live.nodes.start:start" for node in nodes]
    },
)
