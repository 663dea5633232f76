# roadtorch on a CPU.
#   docker build --tag roadtorch .
#   docker run --rm --volume "$PWD:/work" --user "$(id -u):$(id -g)" roadtorch infer street --out roads
# The base by its digest, as yours is to know: --build-arg BASE=python:3.11-slim@sha256:…
ARG BASE=python:3.11-slim
FROM $BASE AS build
WORKDIR /src
COPY constraints.txt LICENSE pyproject.toml README.md ./
COPY requirements requirements
COPY scripts/venv.sh scripts/
COPY configs configs
COPY roadtorch roadtorch
# Which extras are installed: video, bags, annotate, … (pyproject.toml), separated by commas.
ARG EXTRAS=video
# The index of CPU wheels has to answer: a torch with CUDA would make the image five times as large.
RUN ["bash", "-euc", "source scripts/venv.sh; python -m venv /opt/roadtorch; \
    INDEX=(--extra-index-url $CPU_INDEX); export PIP_NO_CACHE_DIR=1; \
    install_tested /opt/roadtorch/bin/python base .; \
    /opt/roadtorch/bin/pip install --quiet --no-compile ${INDEX[@]} -c constraints.txt .[$EXTRAS]"]
# Tries what was installed, and leaves the bytecode of what a run imports and of nothing else.
RUN /opt/roadtorch/bin/python -c "import torch; assert torch.version.cuda is None" \
    && /opt/roadtorch/bin/roadtorch doctor

FROM $BASE
COPY --from=build /opt/roadtorch /opt/roadtorch
RUN useradd --create-home --uid 10001 roadtorch
USER 10001
ENV PATH=/opt/roadtorch/bin:$PATH PYTHONDONTWRITEBYTECODE=1 MPLCONFIGDIR=/tmp/matplotlib
WORKDIR /work
ENTRYPOINT ["roadtorch"]
CMD ["--help"]
