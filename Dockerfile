# docker build -t fenics_crack .
# docker run --rm -it -u "$(id -u):$(id -g)" -v "$PWD:/work" fenics_crack
#
# Not built as a whole where it was written, which had no container engine: the commands were run one
# by one on a bare Debian 13, with Debian's Python in a virtual environment in place of the image's.
FROM python:3.13-slim
# gcc compiles the kernel and forms; gmsh and VTK load the other libraries.
RUN apt-get update && apt-get install --yes --no-install-recommends gcc libc6-dev \
    libgl1 libglu1-mesa libxcursor1 libxft2 libxinerama1 libegl1 libgl1-mesa-dri && \
    rm -rf /var/lib/apt/lists/*
COPY . /fenics_crack
RUN python3 -m pip install --no-cache-dir --no-compile --editable '/fenics_crack[dolfinx]'
# Any user may write there, where compiled forms are kept.
ENV HOME=/tmp
WORKDIR /work
