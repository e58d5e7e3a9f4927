// SPDX-License-Identifier: Apache-2.0

//: sweep_all
// Tiles of 6x6 live in registers, one a lane, so that a pivot reads nothing but its columns. Whoever
// computes the columns of the next pivot writes them to the other copy: one barrier a pivot.
#if defined(__CUDA_ARCH__)
    const int most = 1;
#else
    const int most = @MOST_TILES@;
#endif
    double own[most][36];
    int places[most][2];
    double* const a = reinterpret_cast<double*>(memory);
    double* columns = a + width * (width + 1) / 2;
    double* next = columns + 3 * width;
    const int parts = (width + 5) / 6;
    const int tiles = parts * (parts + 1) / 2;
    bool definite = true;
    WP_TILE_SYNC();
    for (int e = lane; e < 3 * width; e += lanes) {
        const int i = e / 3 > e % 3 ? e / 3 : e % 3;
        columns[e] = a[i * (i + 1) / 2 + e / 3 + e % 3 - i];
    }
    for (int t = 0; t < most && lane + t * lanes < tiles; ++t) {
        int row = 0, left = lane + t * lanes;
        while (left > row)
            left -= ++row;
        places[t][0] = row;
        places[t][1] = left;
        #pragma unroll
        for (int r = 0; r < 6; ++r) {
            #pragma unroll
            for (int c = 0; c < 6; ++c) {
                const int i = 6 * row + r, j = 6 * left + c;
                const int high = i > j ? i : j, low = i > j ? j : i;
                own[t][6 * r + c] = high < width ? a[high * (high + 1) / 2 + low] : 0.0;
            }
        }
    }
    #pragma unroll 1
    for (int block = 0; block < parts; ++block) {
        #pragma unroll
        for (int half = 0; half < 2; ++half) {
            const int pivot = 6 * block + 3 * half;
            if (pivot >= width)
                break;
            WP_TILE_SYNC();
            // The inverse of the 3x3 block at the pivot, by its cofactors.
            const double* const d = columns + 3 * pivot;
            const double c00 = d[4] * d[8] - d[5] * d[5];
            const double c01 = d[2] * d[5] - d[1] * d[8];
            const double c02 = d[1] * d[5] - d[2] * d[4];
            const double minor = d[0] * d[4] - d[1] * d[1];
            const double det = d[0] * c00 + d[1] * c01 + d[2] * c02;
            definite = definite && d[0] > 0.0 && minor > 0.0 && det > 0.0;
            const double scale = 1.0 / det;
            const double i00 = c00 * scale, i01 = c01 * scale, i02 = c02 * scale;
            const double i11 = (d[0] * d[8] - d[2] * d[2]) * scale;
            const double i12 = (d[1] * d[2] - d[0] * d[5]) * scale;
            const double i22 = minor * scale;
            const int next_block = half == 0 ? block : block + 1;
            for (int t = 0; t < most && lane + t * lanes < tiles; ++t) {
                const int row = places[t][0], left = places[t][1];
                // Of a row of the pivot the row of the inverse, of others minus their columns
                // times it.
                double u[6][3];
                #pragma unroll
                for (int r = 0; r < 6; ++r) {
                    if (row == block && r / 3 == half) {
                        u[r][0] = r % 3 == 0 ? i00 : r % 3 == 1 ? i01 : i02;
                        u[r][1] = r % 3 == 0 ? i01 : r % 3 == 1 ? i11 : i12;
                        u[r][2] = r % 3 == 0 ? i02 : r % 3 == 1 ? i12 : i22;
                    } else if (6 * row + r < width) {
                        const double* const c = columns + 3 * (6 * row + r);
                        u[r][0] = -(c[0] * i00 + c[1] * i01 + c[2] * i02);
                        u[r][1] = -(c[0] * i01 + c[1] * i11 + c[2] * i12);
                        u[r][2] = -(c[0] * i02 + c[1] * i12 + c[2] * i22);
                    } else {
                        u[r][0] = u[r][1] = u[r][2] = 0.0;
                    }
                }
                #pragma unroll
                for (int c = 0; c < 6; ++c) {
                    if (6 * left + c >= width)
                        break;
                    const double* const v = columns + 3 * (6 * left + c);
                    const double v0 = v[0], v1 = v[1], v2 = v[2];
                    const bool of_pivot = left == block && c / 3 == half;
                    #pragma unroll
                    for (int r = 0; r < 6; ++r) {
                        double value = u[r][0] * v0 + u[r][1] * v1 + u[r][2] * v2;
                        if (row != block || r / 3 != half)
                            value += own[t][6 * r + c];
                        own[t][6 * r + c] = of_pivot ? -u[r][c % 3] : value;
                    }
                }
                if (left == next_block) {
                    #pragma unroll
                    for (int r = 0; r < 6; ++r) {
                        if (6 * row + r < width) {
                            #pragma unroll
                            for (int k = 0; k < 3; ++k)
                                next[3 * (6 * row + r) + k] = own[t][6 * r + 3 - 3 * half + k];
                        }
                    }
                } else if (row == next_block) {
                    #pragma unroll
                    for (int c = 0; c < 6; ++c)
                        #pragma unroll
                        for (int k = 0; k < 3; ++k)
                            next[3 * (6 * left + c) + k] = own[t][6 * (3 - 3 * half + k) + c];
                }
            }
            double* const swap = columns;
            columns = next;
            next = swap;
        }
    }
    for (int t = 0; t < most && lane + t * lanes < tiles; ++t) {
        const int row = places[t][0], left = places[t][1];
        #pragma unroll
        for (int r = 0; r < 6; ++r) {
            #pragma unroll
            for (int c = 0; c < 6; ++c) {
                const int i = 6 * row + r, j = 6 * left + c;
                if (i < width && j <= i)
                    a[i * (i + 1) / 2 + j] = own[t][6 * r + c];
            }
        }
    }
    WP_TILE_SYNC();
    return definite;

//: get_symmetric
    const int high = row > column ? row : column;
    const int low = row > column ? column : row;
    return reinterpret_cast<const double*>(memory)[high * (high + 1) / 2 + low];
