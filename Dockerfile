# An empty Debian in which the two commands of the README have run.
#   docker build -t taccel-lab .               make demo: the default image
#   docker build --target test .               make test on top of it
#   docker run --rm -v "$PWD:/work" taccel-lab press gelsight_mini --indenter sphere:4 --depth-mm 0.5
# Files in /work belong to root; add --user "$(id -u):$(id -g)" to keep them yours. Live pages:
# docker run --rm --network host taccel-lab view gelsight_mini.
# constraints.txt holds exact versions for Python 3.11, which is Debian 12's.
FROM debian:bookworm-slim AS demo
RUN apt-get update -qq \
    && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
        ca-certificates git make python3 python3-venv >/dev/null
# A home in which any --user may keep compiled kernels.
ENV HOME=/home/lab
WORKDIR /taccel-lab
COPY . .
RUN make demo && chmod -R a+rwX "$HOME"

FROM demo AS test
RUN make test

FROM demo
ENV PATH=/taccel-lab/.venv/bin:$PATH
WORKDIR /work
ENTRYPOINT ["taccel-lab"]
CMD ["--help"]
