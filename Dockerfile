# duplex-kinects without a display: batch, replay, export, CI. No sensor, no viewer.
#   docker build --tag duplex-kinects .
#   docker run --rm --volume "$PWD:/data" --volume duplex-cache:/cache duplex-kinects fuse a.csv b.csv --save s.rrd --no-viewer
FROM python:3.13-slim-bookworm AS build
WORKDIR /src
COPY pyproject.toml README.md LICENSE ./
COPY fusion fusion
COPY devices devices
COPY recordings recordings
COPY viewer_app viewer_app
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /dist .

FROM python:3.13-slim-bookworm
COPY --from=build /dist /dist
RUN wheel="$(echo /dist/*.whl)" \
    && pip install --no-cache-dir "${wheel}[export,cluster,zenoh]" \
    && useradd --create-home --uid 1000 duplex \
    && mkdir /cache /data \
    && chown duplex /cache /data
# Compiled kernels depend on the processor, so they are made on first use; a volume at /cache keeps them, and the
# body tracker's networks.
ENV NUMBA_CACHE_DIR=/cache/kernels \
    DUPLEX_TRACKER_MODELS=/cache/blazepose \
    OPENBLAS_NUM_THREADS=1
USER duplex
WORKDIR /data
ENTRYPOINT ["duplex"]
CMD ["--help"]
