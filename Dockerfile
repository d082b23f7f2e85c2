# The demo, with everything that it needs: docker build -t bayes-rs . && docker run --rm bayes-rs
# Results on the disk of the host: docker run --rm -v "$PWD/out:/work" --user "$(id -u)" bayes-rs
# tests/test_packaging.py holds it against the README and the files of the project; no image was built with it yet.
FROM python:3.11-slim

WORKDIR /source
COPY pyproject.toml README.md LICENSE ./
COPY bayes_rs bayes_rs
COPY models models
RUN pip install --no-cache-dir . && rm -rf /source

RUN useradd --create-home --uid 1000 user && mkdir /work && chown user /work
USER user
ENV HOME=/tmp PYTHONDONTWRITEBYTECODE=1 OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
WORKDIR /work
ENTRYPOINT ["bayes-rs"]
CMD ["demo", "--overwrite"]
