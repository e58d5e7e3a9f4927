// SPDX-License-Identifier: Apache-2.0

//: packed_product
// Written out in C++: arrays of Warp carry strides, which cost registers and multiplications here.
// Several entries at a time, the last of them left out where there are fewer: taken one by one, they
// would wait for memory one by one. The matrix is read past the caches, where the vectors stay.
#if defined(__CUDA_ARCH__)
    const auto read = [](const double* from) { return __ldcs(from); };
#else
    const auto read = [](const double* from) { return *from; };
#endif
    const double* const a = packed.data + 3 * first + place;
    const int* const column = columns.data + first + place;
    double total = 0.0;
    #pragma unroll 1
    for (int k = 0; k < count; k += @GROUP@) {
        int at[@GROUP@];
        double row[3 * @GROUP@];
        #pragma unroll
        for (int i = 0; i < @GROUP@; ++i) {
            if (k + i < count) {
                at[i] = 3 * column[32 * (k + i)];
                #pragma unroll
                for (int c = 0; c < 3; ++c)
                    row[3 * i + c] = read(a + 96 * (k + i) + 32 * c);
            }
        }
        #pragma unroll
        for (int i = 0; i < @GROUP@; ++i) {
            if (k + i < count) {
                const double* const u = x.data + at[i];
                total += row[3 * i] * u[0] + row[3 * i + 1] * u[1] + row[3 * i + 2] * u[2];
            }
        }
    }
    return total;
