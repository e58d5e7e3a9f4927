// SPDX-License-Identifier: Apache-2.0

//: block_diagonal
// Corners of a box around one vector of each thread of a block, taken together.
#if defined(__CUDA_ARCH__)
    __shared__ double parts[32][6];
    double a[3] = {low[0], low[1], low[2]};
    double b[3] = {high[0], high[1], high[2]};
    #pragma unroll
    for (int k = 0; k < 3; ++k)
        for (int step = 16; step > 0; step >>= 1) {
            a[k] = fmin(a[k], __shfl_xor_sync(0xffffffffu, a[k], step));
            b[k] = fmax(b[k], __shfl_xor_sync(0xffffffffu, b[k], step));
        }
    const int warp = threadIdx.x >> 5;
    if ((threadIdx.x & 31) == 0)
        for (int k = 0; k < 3; ++k) {
            parts[warp][k] = a[k];
            parts[warp][3 + k] = b[k];
        }
    __syncthreads();
    double sum = 0.0;
    for (int k = 0; k < 3; ++k) {
        double least = parts[0][k], most = parts[0][3 + k];
        for (int i = 1; i < static_cast<int>(blockDim.x >> 5); ++i) {
            least = fmin(least, parts[i][k]);
            most = fmax(most, parts[i][3 + k]);
        }
        sum += (most - least) * (most - least);
    }
    __syncthreads();
    return sqrt(sum);
#else
    double sum = 0.0;
    for (int k = 0; k < 3; ++k)
        sum += (high[k] - low[k]) * (high[k] - low[k]);
    return sqrt(sum);
#endif
