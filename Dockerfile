# The package with its extras `train` and `render`: docker build --tag mapf-pz . && docker run --rm mapf-pz mapf-pz evaluate --policy pibt
FROM python:3.13-slim

COPY . /source
# PyTorch without CUDA, which is much smaller; for GPUs, omit the index.
RUN pip install --no-cache-dir --extra-index-url https://download.pytorch.org/whl/cpu \
    --constraint /source/constraints.txt '/source[train,render]'

RUN useradd --create-home user
USER user
WORKDIR /home/user
# For the processor of the machine that builds the image; on another one, kernels are compiled on first use.
RUN mapf-pz compile
