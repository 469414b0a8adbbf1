# SPDX-License-Identifier: MIT OR Apache-2.0
# The program `rsrectify`, the GStreamer element, and `rsrectify-batch` with Ray, for batches and as a worker of a cluster.
#
#   docker build --tag rsrectify .
#   docker run --rm --volume "$PWD":/clips rsrectify rsrectify fix clip.mov
#
# docs/install.md has more. Both stages must be of the same release of Debian: the program is linked to its GStreamer.
ARG DEBIAN=bookworm
ARG RUST=1.95

FROM rust:${RUST}-slim-${DEBIAN} AS build
RUN apt-get update && apt-get install -y --no-install-recommends \
    libgstreamer-plugins-base1.0-dev libgstreamer1.0-dev pkg-config python3 && \
  rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY . .
# The caches outlive the step, so that a change of the sources compiles no dependency again. The folder of plugins
# carries the name of the architecture.
RUN --mount=type=cache,target=/usr/local/cargo/registry --mount=type=cache,target=/source/target \
  cargo build --release --locked -p gst-plugin-rsrectify -p rsrectify-cli && \
  plugins=$(pkg-config --variable=pluginsdir gstreamer-1.0) && \
  install -D target/release/rsrectify -t /image/usr/bin && \
  install -D -m 644 target/release/libgstrsrectify.so -t "/image$plugins" && \
  scripts/bill-of-materials /image/usr/share/doc/rsrectify && \
  install -D -m 644 gst-plugin/presets/GstRsRectify.prs -t /image/usr/share/gstreamer-1.0/presets && \
  install -D -m 644 LICENSE-* program/fonts/LICENSE* -t /image/usr/share/doc/rsrectify

# Apart from the build, so that neither waits for the other; the folder is the same as in the image, because a virtual
# environment cannot be moved.
FROM debian:${DEBIAN}-slim AS batch
RUN apt-get update && apt-get install -y --no-install-recommends python3 python3-venv && rm -rf /var/lib/apt/lists/*
RUN python3 -m venv /opt/rsrectify-batch
# All machines of a cluster must have the same version of Ray, and of Python up to its second number.
ARG RAY=2.60.0
RUN /opt/rsrectify-batch/bin/pip install --no-cache-dir "ray==${RAY}"
COPY batch /source/batch
RUN /opt/rsrectify-batch/bin/pip install --no-cache-dir '/source/batch[ray]' "ray==${RAY}"

FROM debian:${DEBIAN}-slim
# What the Debian package of the program depends on, and the tools for pipelines with the element.
RUN apt-get update && apt-get install -y --no-install-recommends \
    gstreamer1.0-libav gstreamer1.0-plugins-bad gstreamer1.0-plugins-base gstreamer1.0-plugins-good \
    gstreamer1.0-plugins-ugly gstreamer1.0-tools python3 && \
  rm -rf /var/lib/apt/lists/* && \
  useradd --create-home rsrectify
COPY --from=batch /opt/rsrectify-batch /opt/rsrectify-batch
COPY --from=build /image /
# GStreamer's list of plugins is made once for all users, also for those that docker run --user gives no home; Ray would
# send statistics of its use.
ENV GST_REGISTRY=/var/cache/gstreamer-1.0/registry.bin RAY_USAGE_STATS_ENABLED=0
# Links rather than a longer PATH, which a login shell would set anew.
RUN ln -s /opt/rsrectify-batch/bin/rsrectify-batch /opt/rsrectify-batch/bin/ray /usr/local/bin/ && \
  mkdir -p /var/cache/gstreamer-1.0 && gst-inspect-1.0 rsrectify >/dev/null && \
  chmod a+r "$GST_REGISTRY" && rsrectify --version && rsrectify-batch --version && \
  install -d -o rsrectify -g rsrectify /clips
USER rsrectify
WORKDIR /clips
# No entry point: the image has several programs, and the first word says which.
CMD ["rsrectify", "--help"]
