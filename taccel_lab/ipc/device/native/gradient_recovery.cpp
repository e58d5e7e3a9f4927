// SPDX-License-Identifier: Apache-2.0

//: block_barrier
#if defined(__CUDA_ARCH__)
    __syncthreads();
#endif
