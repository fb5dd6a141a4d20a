# The service with its kernels compiled in. Build: docker build -t wayside .   Run: see docker-compose.yml
ARG PYTHON=3.12
FROM python:${PYTHON}-slim AS build
ARG PYTHON
WORKDIR /src
COPY . .
# Byte code comes with the packages: who runs them may not write it, and each start would make it anew.
ENV UV_COMPILE_BYTECODE=1
RUN scripts/uv venv --quiet --python "python${PYTHON}" /opt/wayside \
    && scripts/uv pip install --quiet --python /opt/wayside/bin/python --require-hashes -r requirements.lock \
    && scripts/uv pip install --quiet --python /opt/wayside/bin/python --no-deps \
        --build-constraints requirements-dev.lock .

FROM python:${PYTHON}-slim
COPY --from=build /opt/wayside /opt/wayside
ENV PATH=/opt/wayside/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    WAYSIDE_KERNEL_CACHE=/var/cache/wayside
RUN useradd --system --no-create-home wayside \
    && install -d -o wayside -g wayside /data /var/cache/wayside
USER wayside
RUN python -m service.warmup
VOLUME /data
EXPOSE 8321
HEALTHCHECK --interval=10s --timeout=3s --start-period=60s \
    CMD ["python", "-c", "import urllib.request; urllib.request.urlopen('http://127.0.0.1:8321/readyz', timeout=2)"]
ENTRYPOINT ["wayside"]
CMD ["serve", "--host", "0.0.0.0", "--data-dir", "/data", "--first-key"]
