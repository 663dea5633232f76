# roadtorch on a CPU.
#   docker build --tag roadtorch .
#   docker run --rm --volume "$PWD:/work" --user "$(id -u):$(id -g)" roadtorch infer street --out roads
FROM python:3.11-slim AS build
WORKDIR /src
COPY constraints.txt LICENSE pyproject.toml README.md ./
COPY scripts/venv.sh scripts/
COPY configs configs
COPY roadtorch roadtorch
# The index of CPU wheels has to answer: a torch with CUDA would make the image five times as large.
RUN ["bash", "-euc", "source scripts/venv.sh; python -m venv /opt/roadtorch; \
    /opt/roadtorch/bin/pip install --no-cache-dir --no-compile --extra-index-url $CPU_INDEX \
    -c constraints.txt ."]
# Tries what was installed, and leaves the bytecode of what a run imports and of nothing else.
RUN /opt/roadtorch/bin/python -c "import torch; assert torch.version.cuda is None" \
    && /opt/roadtorch/bin/roadtorch doctor

FROM python:3.11-slim
COPY --from=build /opt/roadtorch /opt/roadtorch
RUN useradd --create-home --uid 10001 roadtorch
USER 10001
ENV PATH=/opt/roadtorch/bin:$PATH PYTHONDONTWRITEBYTECODE=1 MPLCONFIGDIR=/tmp/matplotlib
WORKDIR /work
ENTRYPOINT ["roadtorch"]
CMD ["--help"]
