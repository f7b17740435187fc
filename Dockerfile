# dynid without a source tree: docker build -t dynid . && docker run --rm -v "$PWD:/work" dynid demo --out /work/demo
# A real arm needs its bus inside: --network host for RTDE, --device /dev/ttyUSB0 for serial lines.
FROM python:3.12-slim AS build
WORKDIR /src
COPY . .
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .

FROM python:3.12-slim
COPY --from=build /wheels /wheels
COPY constraints.txt /tmp/constraints.txt
RUN pip install --no-cache-dir -c /tmp/constraints.txt /wheels/*.whl && rm -r /wheels
RUN useradd --create-home arm
USER arm
WORKDIR /work
ENTRYPOINT ["dynid"]
CMD ["--help"]
