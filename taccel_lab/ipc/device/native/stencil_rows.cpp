// SPDX-License-Identifier: Apache-2.0

//: stencil_stage
// Rows and coefficients of the stencil of each thread (of ten unknowns, three numbers and half a one
// each), side by side in shared memory: indexed by what is only known at run time, they would else
// lie in a thread's own part of the GPU's memory.
#if defined(__CUDA_ARCH__)
    __shared__ double stage[35 * WP_TILE_BLOCK_DIM];
    return reinterpret_cast<wp::uint64>(stage);
#else
    static double stage[35];
    return reinterpret_cast<wp::uint64>(stage);
#endif

//: open_row
@PLACES@
    *row = value;
    coefficient[0] = 0.0;
    coefficient[step] = 0.0;
    coefficient[2 * step] = 0.0;

//: add_coefficients
@PLACES@
    coefficient[0] += value[0];
    coefficient[step] += value[1];
    coefficient[2 * step] += value[2];

//: coefficients_at
@PLACES@
    return wp::vec_t<3, wp::float64>(coefficient[0], coefficient[step], coefficient[2 * step]);

//: places
#if defined(__CUDA_ARCH__)
    const int step = WP_TILE_BLOCK_DIM, mine = threadIdx.x;
#else
    const int step = 1, mine = 0;
#endif
    double* const coefficient = reinterpret_cast<double*>(stage) + 3 * step * at + mine;
    int* const row = reinterpret_cast<int*>(reinterpret_cast<double*>(stage) + 30 * step)
        + step * at + mine;
    (void)coefficient;
    (void)row;
