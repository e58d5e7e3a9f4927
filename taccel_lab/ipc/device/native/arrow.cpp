// SPDX-License-Identifier: Apache-2.0

//: load_matrix
// Element (i, j) of block code >> 1 lies at (j, i) where the code is odd.
@NAMES@
    int* const copied = reinterpret_cast<int*>(program);
    const int* const source = listed.data;
    if (copied != source) {
        #pragma unroll 4
        for (int e = lane; e < layout.word_count; e += lanes)
            copied[e] = source[e];
    }
    const int* const code = codes.data;
    const double* const value = values.data;
    const int end = 9 * layout.blocks;
    #pragma unroll 8
    for (int e = lane; e < end; e += lanes) {
        const int own = code[e / 9];
        const int part = e % 9;
        const int turned = own & 1 ? 3 * (part % 3) + part / 3 : part;
        factor[e] = own < 0 ? 0.0 : value[9 * (own >> 1) + turned];
    }
    if (lane == 0)
        numbers[layout.flag] = numbers[layout.flag + 1] = 0.0;
    WP_TILE_SYNC();
    // Every block is listed twice: one of them is that of a border row and a gel column.
    #pragma unroll 1
    for (int e = lane; e < 9 * extra_count; e += lanes) {
        const int own = extra_codes.data[e / 9];
        const int part = e % 9;
        const int i = extra_places.data[own >> 1][own & 1];
        const int j = extra_places.data[own >> 1][1 - (own & 1)];
        const int c = border_places.data[i];
        const bool inner = border_places.data[j] < 0;
        const int turned = own & 1 ? 3 * (part % 3) + part / 3 : part;
        if (c >= 0 && inner)
            factor[9 * (words[layout.starts + places.data[j]] + 1 + c) + part] +=
                extra_values.data[9 * (own >> 1) + turned];
        if (c < 0 && inner)
            numbers[layout.flag] = 1.0;
    }

//: factor_columns
@NAMES@
    double* const roots = numbers + layout.roots;
    const int* const pair_starts = words + layout.pair_starts;
    const int* const pairs = words + layout.pairs;
    const int* const owners = words + layout.owners;
    const int* const level_starts = words + layout.level_starts;
    const auto inverse_root = [](double value) {
#if defined(__CUDA_ARCH__)
        return ::rsqrt(value);
#else
        return 1.0 / wp::sqrt(value);
#endif
    };
    // A negative pivot changes its sign, and with it the matrix; a small one would lead far away.
    const auto turned = [](double pivot, double least) {
        return pivot < 0.0 ? (-pivot > least ? -pivot : least) : pivot;
    };
    // Words never change: the first that a lane needs after a barrier are read before it.
    int first = level_starts[0];
    int end = level_starts[1];
    int begin = pair_starts[first + lane / 9];
    int stop = pair_starts[first + lane / 9 + 1];
    #pragma unroll 1
    for (int level = 0; level < layout.level_count; ++level) {
        const int next_end = level_starts[level + 2];
        unsigned owner = owners[first + lane / 3];
        #pragma unroll 1
        for (int task = 9 * first + lane; task < 9 * end; task += lanes) {
            const int block = task / 9;
            if (task >= 9 * first + lanes) {
                begin = pair_starts[block];
                stop = pair_starts[block + 1];
            }
            const int row = 3 * (task % 9 / 3);
            const int column = 3 * (task % 3);
            double total = 0.0, more = 0.0, last = 0.0;
            #pragma unroll 4
            for (int e = begin; e < stop; ++e) {
                const unsigned pair = pairs[e];
                const double* const a = factor + 9 * (pair >> 16) + row;
                const double* const b = factor + 9 * (pair & 0xffffu) + column;
                total += a[0] * b[0];
                more += a[1] * b[1];
                last += a[2] * b[2];
            }
            if (stop > begin)
                factor[task] -= total + more + last;
        }
        WP_TILE_SYNC();
        if (9 * end + lane < 9 * next_end) {
            begin = pair_starts[end + lane / 9];
            stop = pair_starts[end + lane / 9 + 1];
        }
        #pragma unroll 1
        for (int task = 3 * first + lane; task < 3 * end; task += lanes) {
            const int block = task / 3;
            if (task >= 3 * first + lanes)
                owner = owners[block];
            const int diagonal = owner & 0xffffu;
            const double* const d = factor + 9 * diagonal;
            const double least = @LEAST_TURNED@ * (turned(d[0], 0.0) + turned(d[4], 0.0) + turned(d[8], 0.0));
            const double d00 = turned(d[0], least);
            const double r00 = inverse_root(d00);
            const double l10 = d[3] * r00;
            const double l20 = d[6] * r00;
            // From the minor, which does not wait for the first root.
            const double minor = d00 * d[4] - d[3] * d[3];
            const double r11 = d00 * r00 * inverse_root(turned(minor, d00 * least));
            const double l21 = (d[7] - l20 * l10) * r11;
            const double rest = d[8] - l20 * l20 - l21 * l21;
            const double r22 = inverse_root(turned(rest, least));
            if (d[0] < 0.0 || minor < 0.0 || rest < 0.0)
                numbers[layout.flag + 1] = 1.0;
            const double r10 = -l10 * r00 * r11;
            const double r21 = -l21 * r11 * r22;
            const double r20 = -(l20 * r00 + l21 * r10) * r22;
            if (block == diagonal) {
                // One row for each of three lanes. The block itself is still read by others.
                double* const root = roots + 9 * (owner >> 16);
                const int i = task % 3;
                root[3 * i] = i == 0 ? r00 : i == 1 ? r10 : r20;
                root[3 * i + 1] = i == 0 ? 0.0 : i == 1 ? r11 : r21;
                root[3 * i + 2] = i == 2 ? r22 : 0.0;
            } else {
                double* const a = factor + 3 * task;
                const double a0 = a[0], a1 = a[1], a2 = a[2];
                a[0] = r00 * a0;
                a[1] = r10 * a0 + r11 * a1;
                a[2] = r20 * a0 + r21 * a1 + r22 * a2;
            }
        }
        first = end;
        end = next_end;
        WP_TILE_SYNC();
    }

//: finish_factor
@NAMES@
    const int width = 3 * layout.m;
    const int* const starts = words + layout.starts;
    const int triangle = width * (width + 1) / 2;
    double* const sums = numbers + layout.sums;
    // Row i of the lower triangle starts at i (i + 1) / 2.
    #pragma unroll 1
    for (int task = lane; task < @SCHUR_CHUNKS@ * triangle; task += lanes) {
        const int chunk = task / triangle;
        const int e = task % triangle;
        int i = 0;
        for (int step = width; step > 0; step >>= 1)
            while (i + step < width && (i + step) * (i + step + 1) / 2 <= e)
                i += step;
        const int j = e - i * (i + 1) / 2;
        double total = 0.0, more = 0.0, last = 0.0;
        #pragma unroll 4
        for (int column = chunk; column < layout.n; column += @SCHUR_CHUNKS@) {
            const double* const base = factor + 9 * (starts[column] + 1);
            const double* const a = base + 3 * i;
            const double* const b = base + 3 * j;
            total += a[0] * b[0];
            more += a[1] * b[1];
            last += a[2] * b[2];
        }
        sums[task] = total + more + last;
    }
    WP_TILE_SYNC();
    // From here on nothing needs the factor as it is: A = L D L^T with unit L.
    const double* const roots = numbers + layout.roots;
    const int* const owners = words + layout.owners;
    #pragma unroll 1
    for (int task = lane; task < 3 * layout.blocks; task += lanes) {
        const int block = task / 3;
        const unsigned owner = owners[block];
        const double* const root = roots + 9 * (owner >> 16);
        double* const a = factor + 3 * task;
        double row[3];
        if (block == static_cast<int>(owner & 0xffffu)) {
            // Inverse of the diagonal block, from the roots alone.
            const int i = task % 3;
            row[0] = root[i];
            row[1] = root[3 + i];
            row[2] = root[6 + i];
        } else {
            row[0] = a[0];
            row[1] = a[1];
            row[2] = a[2];
        }
        for (int c = 0; c < 3; ++c)
            a[c] = row[0] * root[c] + row[1] * root[3 + c] + row[2] * root[6 + c];
    }
    double* const schur = numbers + layout.schur;
    #pragma unroll 1
    for (int e = lane; e < width * width; e += lanes) {
        const int i = e / width;
        const int j = e % width;
        const int own = border_codes.data[i / 3 * layout.m + j / 3];
        double value = 0.0;
        if (own >= 0)
            value = values.data[
                9 * (own >> 1) + (own & 1 ? 3 * (j % 3) + i % 3 : 3 * (i % 3) + j % 3)];
        const int high = i > j ? i : j;
        const int low = i > j ? j : i;
        for (int chunk = 0; chunk < @SCHUR_CHUNKS@; ++chunk)
            value -= sums[chunk * triangle + high * (high + 1) / 2 + low];
        schur[e] = value;
    }
    WP_TILE_SYNC();
    #pragma unroll 1
    for (int e = lane; e < 9 * extra_count; e += lanes) {
        const int own = extra_codes.data[e / 9];
        const int part = e % 9;
        const int i = border_places.data[extra_places.data[own >> 1][own & 1]];
        const int j = border_places.data[extra_places.data[own >> 1][1 - (own & 1)]];
        const int turned = own & 1 ? 3 * (part % 3) + part / 3 : part;
        if (i >= 0 && j >= 0)
            schur[(3 * i + part / 3) * width + 3 * j + part % 3] +=
                extra_values.data[9 * (own >> 1) + turned];
    }
    // Gauss-Jordan, from one copy to the other and back, negative pivots as above.
    double* old = schur;
    double* next = schur + width * width;
    #pragma unroll 1
    for (int pivot = 0; pivot < width; ++pivot) {
        WP_TILE_SYNC();
        const double scale = old[pivot * width + pivot];
        const double inverse = 1.0 / (scale < 0.0 ? -scale : scale);
        if (scale < 0.0)
            numbers[layout.flag + 1] = 1.0;
        #pragma unroll 1
        for (int e = lane; e < width * width; e += lanes) {
            const int i = e / width;
            const int j = e % width;
            const double across = j == pivot ? 1.0 : old[pivot * width + j];
            const double down = old[i * width + pivot];
            const double rest = j == pivot ? 0.0 : old[e];
            next[e] = i == pivot ? across * inverse : rest - down * across * inverse;
        }
        double* const swap = old;
        old = next;
        next = swap;
    }

//: names
    double* const numbers = reinterpret_cast<double*>(memory);
    const int* const words = reinterpret_cast<const int*>(program);
    double* const factor = numbers;
    (void)words;
    (void)factor;

//: solve_factored
@NAMES@
    double* const z = numbers + layout.z;
    double* const x = numbers + layout.x;
    const int n = layout.n;
    const int width = 3 * layout.m;
    const int* const step_starts = words + layout.step_starts;
    const int* const targets = words + layout.targets;
    const int* const entries = words + layout.entries;
    // Words never change: the first that a lane needs after a barrier are read before it.
    int first = step_starts[0], end = step_starts[1], next_end = step_starts[2];
    unsigned target = targets[first + lane / 3];
    int stop = targets[first + lane / 3 + 1] & 0xffff;
    double* y = z;
    int across = 1, down = 3;
    #pragma unroll 1
    for (int step = 0; step <= layout.step_count; ++step) {
        if (step == layout.forward_steps) {
            const int* const starts = words + layout.starts;
            if (width > 0) {
                double* const sums = numbers + layout.sums;
                double* const rest = sums + @BORDER_CHUNKS@ * width;
                #pragma unroll 1
                for (int task = lane; task < @BORDER_CHUNKS@ * width; task += lanes) {
                    const int i = task / @BORDER_CHUNKS@;
                    double total = 0.0, more = 0.0, last = 0.0;
                    #pragma unroll 3
                    for (int j = task % @BORDER_CHUNKS@; j < n; j += @BORDER_CHUNKS@) {
                        const double* const a = factor + 9 * (starts[j] + 1) + 3 * i;
                        const double* const u = z + 3 * j;
                        total += a[0] * u[0];
                        more += a[1] * u[1];
                        last += a[2] * u[2];
                    }
                    sums[task] = total + more + last;
                }
                WP_TILE_SYNC();
                #pragma unroll 1
                for (int i = lane; i < width; i += lanes) {
                    double total = z[3 * n + i], more = 0.0;
                    // Lanes begin at their own banks.
                    #pragma unroll 4
                    for (int k = 0; k < @BORDER_CHUNKS@; k += 2) {
                        total -= sums[i * @BORDER_CHUNKS@ + (k + i) % @BORDER_CHUNKS@];
                        more += sums[i * @BORDER_CHUNKS@ + (k + 1 + i) % @BORDER_CHUNKS@];
                    }
                    rest[i] = total - more;
                }
                WP_TILE_SYNC();
                const double* const inverse = numbers + layout.schur + width % 2 * width * width;
                #pragma unroll 1
                for (int i = lane; i < width; i += lanes) {
                    double total = 0.0, more = 0.0;
                    #pragma unroll 3
                    for (int k = 0; k < width; k += 3) {
                        // Down a column of the symmetric inverse.
                        total += inverse[k * width + i] * rest[k];
                        more += inverse[(k + 1) * width + i] * rest[k + 1];
                        total += inverse[(k + 2) * width + i] * rest[k + 2];
                    }
                    x[3 * n + i] = total + more;
                }
                WP_TILE_SYNC();
            }
            const double* const border = x + 3 * n;
            #pragma unroll 1
            for (int task = lane; task < 3 * n; task += lanes) {
                const int column = task / 3;
                const int c = task % 3;
                const double* const own = factor + 9 * starts[column];
                const double* const u = z + 3 * column;
                double total = own[3 * c] * u[0] + own[3 * c + 1] * u[1] + own[3 * c + 2] * u[2];
                double more = 0.0, last = 0.0;
                #pragma unroll 4
                for (int k = 0; k < width; k += 3) {
                    total -= own[9 + 3 * k + c] * border[k];
                    more += own[9 + 3 * k + 3 + c] * border[k + 1];
                    last += own[9 + 3 * k + 6 + c] * border[k + 2];
                }
                x[task] = total - more - last;
            }
            y = x;
            across = 3;
            down = 1;
            WP_TILE_SYNC();
        }
        if (step == layout.step_count)
            break;
        #pragma unroll 1
        for (int task = 3 * first + lane; task < 3 * end; task += lanes) {
            const int c = task % 3;
            if (task >= 3 * first + lanes) {
                target = targets[task / 3];
                stop = targets[task / 3 + 1] & 0xffff;
            }
            double total = 0.0, more = 0.0, last = 0.0;
            #pragma unroll 2
            for (int e = target & 0xffffu; e < stop; ++e) {
                const unsigned entry = entries[e];
                const double* const a = factor + 9 * (entry >> 16) + c * down;
                const double* const u = y + 3 * (entry & 0xffffu);
                total += a[0] * u[0];
                more += a[across] * u[1];
                last += a[2 * across] * u[2];
            }
            y[3 * (target >> 16) + c] -= total + more + last;
        }
        first = end;
        end = next_end;
        next_end = step_starts[step + 3];
        if (3 * first + lane < 3 * end) {
            target = targets[first + lane / 3];
            stop = targets[first + lane / 3 + 1] & 0xffff;
        }
        WP_TILE_SYNC();
    }
