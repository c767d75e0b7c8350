# duplex-kinects without a display: batch, replay, export, CI. No sensor, no viewer. The user in the container has the
# id 1000; a folder that is mounted at /data must be writable for it.
#   docker build --tag duplex-kinects .
#   docker run --rm --volume "$PWD:/data" --volume duplex-cache:/cache duplex-kinects fuse a.csv b.csv --save s.rrd --no-viewer
FROM python:3.13-slim-bookworm AS build
WORKDIR /src
COPY pyproject.toml README.md LICENSE ./
COPY fusion fusion
COPY devices devices
COPY recordings recordings
COPY viewer_app viewer_app
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /dist . \
    && echo "duplex-kinects[export,cluster,zenoh] @ file://$(echo /dist/*.whl)" > /dist/requirements.txt

FROM python:3.13-slim-bookworm
COPY --from=build /dist /dist
RUN pip install --no-cache-dir --requirement /dist/requirements.txt \
    && useradd --create-home --uid 1000 duplex \
    && mkdir /cache /data \
    && chown duplex /cache /data
# Compiled kernels depend on the processor, so they are made on first use; a volume at /cache keeps them, and the
# body tracker's networks.
ENV NUMBA_CACHE_DIR=/cache/kernels \
    DUPLEX_TRACKER_MODELS=/cache/blazepose \
    OPENBLAS_NUM_THREADS=1
USER 1000
WORKDIR /data
ENTRYPOINT ["duplex"]
CMD ["--help"]
