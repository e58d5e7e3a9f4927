// SPDX-License-Identifier: Apache-2.0

//: column_product
// Written out in C++: arrays of Warp carry strides, which cost registers and multiplications here.
    const wp::float64* a = inverses.data + at;
    const wp::float64* u = r.data + first;
    wp::float64 total = 0.0;
    #pragma unroll 8
    for (int k = 0; k < width; ++k)
        total += a[width * k] * u[k];
    return total;

//: row_product
    const double* const a = inverses.data + 3 * task;
    const double* const u = r.data + task - task % 3;
    return a[0] * u[0] + a[1] * u[1] + a[2] * u[2];
