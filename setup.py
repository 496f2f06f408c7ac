"""The compiled part of the package; everything else is in pyproject.toml."""

from multiprocessing.pool import ThreadPool

from setuptools import setup
from setuptools.command.build_ext import build_ext


class ParallelBuild(build_ext):
    """Compiles the C files side by side, one for each processor."""

    def build_extensions(self) -> None:
        """Called by setuptools."""
        compile_files = self.compiler.compile

        def compile_each(sources: list[str], **options: object) -> list[str]:
            with ThreadPool() as pool:
                files = pool.map(lambda source: compile_files([source], **options), sources)
            return [file for [file] in files]

        self.compiler.compile = compile_each
        super().build_extensions()


setup(
    cffi_modules=["fenics_crack/kernel/build.py:builder"],
    cmdclass={"build_ext": ParallelBuild},
    options={"bdist_wheel": {"py_limited_api": "cp311"}},  # the kernel serves every later Python
)
