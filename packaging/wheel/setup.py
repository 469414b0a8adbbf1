# SPDX-License-Identifier: MIT OR Apache-2.0

"""A wheel for one kind of machine and any Python, with a bill of materials where PEP 770 has it."""

from pathlib import Path
from shutil import copytree

from setuptools import setup
from setuptools.command.bdist_wheel import bdist_wheel


class Wheel(bdist_wheel):
    def finalize_options(self):
        super().finalize_options()
        self.root_is_pure = False

    def get_tag(self):
        return "py3", "none", super().get_tag()[2]

    def write_wheelfile(self, wheelfile_base, *arguments, **options):
        super().write_wheelfile(wheelfile_base, *arguments, **options)
        copytree("sboms", Path(wheelfile_base) / "sboms", dirs_exist_ok=True)


setup(cmdclass={"bdist_wheel": Wheel})
