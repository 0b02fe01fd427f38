"""Package of the ROS 2 nodes. The computation comes from the pip package megrasp_core."""

from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "megrasp_ros"
NODES = {
    "grasp_server": "entry:grasp_server",
    "sim_cell": "entry:sim_cell",
    "bin_clearing": "entry:bin_clearing",
    "tool_changer": "entry:tool_changer",
    "cloud_replay": "entry:cloud_replay",
    "megrasp_call": "entry:megrasp_call",
    "bench_node": "entry:bench_node",
}

setup(
    name=NAME,
    version=ElementTree.parse("package.xml").findtext("version"),
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=True,
    maintainer="Megrasp developers",
    maintainer_email="megrasp@users.noreply.github.com",
    description="ROS 2 nodes of Megrasp.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [f"{node} = {NAME}.{module}" for node, module in NODES.items()]
    },
)
