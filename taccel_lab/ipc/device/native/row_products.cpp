// SPDX-License-Identifier: Apache-2.0

//: segment_product
// Written out in C++: arrays of Warp carry strides, which cost registers and multiplications here.
    const wp::int32* column = columns.data;
    const wp::int32* code = codes.data;
    const wp::float64* across = values.data;
    wp::float64 total = 0.0;
    #pragma unroll 2
    for (int k = first; k < end && code[k] >= 0; k += stride) {
        // Blocks of the upper triangle are stored transposed.
        const int flipped = code[k] & 1;
        const int step = flipped ? 3 : 1;
        const wp::float64* a = across + 9 * (code[k] >> 1) + (flipped ? component : 3 * component);
        const wp::float64* u = x.data + 3 * column[k];
        total += a[0] * u[0] + a[step] * u[1] + a[2 * step] * u[2];
    }
    return total;
