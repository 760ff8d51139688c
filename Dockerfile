# planish for clusters and servers (docs/how-to/cluster-image.md). Build the wheel first:
#   python3 run.py wheel && docker build -t planish .
FROM python:3.13-slim

# The versions of the lock, checked by their hashes; nothing is compiled here.
COPY requirements/run.lock dist/planish-*.whl /install/
RUN pip install --no-cache-dir --no-deps --only-binary=:all: --require-hashes -r /install/run.lock \
    && pip install --no-cache-dir --no-deps /install/planish-*.whl \
    && rm -r /install

# Any user may keep compiled kernels here. Where the image is read-only they go into the home of the user.
RUN mkdir -m 1777 /cache && useradd --create-home planish
ENV NUMBA_CACHE_DIR=/cache/numba MPLCONFIGDIR=/cache/matplotlib PYTHONUNBUFFERED=1

USER planish
WORKDIR /data
ENTRYPOINT ["planish"]
