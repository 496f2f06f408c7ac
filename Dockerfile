# docker build -t fenics_crack .
# docker run --rm -it -u "$(id -u):$(id -g)" -v "$PWD:/work" fenics_crack
FROM debian:13
COPY . /fenics_crack
RUN sh /fenics_crack/install.sh && rm -rf /var/lib/apt/lists/*
ENV PATH=/fenics_crack/.venv/bin:$PATH
# Any user may write there, where compiled forms are kept; in a container, mpirun may run as root.
ENV HOME=/tmp OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
WORKDIR /work
