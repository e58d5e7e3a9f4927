// SPDX-License-Identifier: Apache-2.0

//: load_matrix
// Element (i, j) of block code >> 1 lies at (j, i) where the code is odd.
@NAMES@
    // Of what it reads a lane asks for all that it can hold before it waits for the first.
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ < 900
    constexpr int held = 8;
#else
    constexpr int held = 16;
#endif
    struct alignas(8) Pair { int first, second; };
    Pair* const copied = reinterpret_cast<Pair*>(program);
    const Pair* const source = reinterpret_cast<const Pair*>(listed.data);
    const int pair_count = copied == source ? 0 : layout.word_count / 2;
    #pragma unroll 1
    for (int start = lane; start < pair_count; start += held * lanes) {
        Pair read[held];
        #pragma unroll
        for (int k = 0; k < held; ++k)
            if (start + k * lanes < pair_count)
                read[k] = source[start + k * lanes];
        #pragma unroll
        for (int k = 0; k < held; ++k)
            if (start + k * lanes < pair_count)
                copied[start + k * lanes] = read[k];
    }
    const int* const code = codes.data;
    const double* const value = values.data;
    // A lane has the same element of all its blocks.
#if defined(__CUDA_ARCH__)
    constexpr int parts = 9;
#else
    constexpr int parts = 1;
#endif
    const int beside = lanes / parts;
    for (int part = lane % parts; part < 9 && lane < parts * beside; part += parts) {
        const int turned = 3 * (part % 3) + part / 3;
        #pragma unroll 1
        for (int start = lane / parts; start < layout.blocks; start += held * beside) {
            double read[held];
            #pragma unroll
            for (int k = 0; k < held; ++k) {
                const int block = start + k * beside;
                const int own = block < layout.blocks ? code[block] : -1;
                read[k] = own < 0 ? 0.0 : value[9 * (own >> 1) + (own & 1 ? turned : part)];
            }
            #pragma unroll
            for (int k = 0; k < held; ++k)
                if (start + k * beside < layout.blocks)
                    factor[9 * (start + k * beside) + part] = read[k];
        }
    }
    const int width = 3 * layout.m;
    double* const schur = numbers + layout.schur;
    for (int e = lane; e < width * width; e += lanes) {
        const int i = e / width;
        const int j = e % width;
        const int own = border_codes.data[i / 3 * layout.m + j / 3];
        const int turned = own & 1 ? 3 * (j % 3) + i % 3 : 3 * (i % 3) + j % 3;
        schur[e] = own < 0 ? 0.0 : value[9 * (own >> 1) + turned];
    }
    if (lane == 0)
        numbers[layout.flag] = numbers[layout.flag + 1] = 0.0;
    WP_TILE_SYNC();
    // Every block is listed twice, as it is and transposed, and a lane takes a whole one: where it
    // goes is read through four lists.
    #pragma unroll 1
    for (int e = lane; e < extra_count; e += lanes) {
        const int own = extra_codes.data[e];
        const int turned = own & 1;
        const auto& place = extra_places.data[own >> 1];
        const int row = turned ? place[1] : place[0];
        const int column = turned ? place[0] : place[1];
        const int c = border_places.data[row];
        const int d = border_places.data[column];
        if (c < 0 && d < 0)
            numbers[layout.flag] = 1.0;
        if (c < 0)
            continue;
        const double* const block = extra_values.data + 9 * (own >> 1);
        const int down = turned ? 1 : 3;
        const int across = turned ? 3 : 1;
        const int step = d < 0 ? 3 : width;
        double* const target = d < 0
            ? factor + 9 * (words[layout.starts + places.data[column]] + 1 + c)
            : schur + 3 * c * width + 3 * d;
        #pragma unroll
        for (int i = 0; i < 3; ++i)
            #pragma unroll
            for (int j = 0; j < 3; ++j)
                target[i * step + j] += block[i * down + j * across];
    }

//: factor_columns
@NAMES@
    double* const roots = numbers + layout.roots;
    double* const z = numbers + layout.z;
    const int* const pair_starts = words + layout.pair_starts;
    const int* const pairs = words + layout.pairs;
    const int* const owners = words + layout.owners;
    const int* const level_starts = words + layout.level_starts;
    const int* const step_starts = words + layout.step_starts;
    const int* const targets = words + layout.targets;
    const int* const entries = words + layout.entries;
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
    int begin = 0, stop = 0, target = 0, last_target = 0;
    #pragma unroll 1
    for (int level = 0; level < layout.level_count; ++level) {
        const int next_end = level_starts[level + 2];
        const int count = end - first;
        // A lane takes a row of a block where there is one for each; else the root is found once.
        const int rows = 3 * count > lanes ? 3 : 1;
        unsigned owner = owners[first + lane * rows / 3];
        // Nothing is subtracted from the first level.
        #pragma unroll 1
        for (int task = 9 * first + lane; level > 0 && task < 9 * end; task += lanes) {
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
        // The load is one more row of the factor. The last lanes are the first without a task.
        #pragma unroll 1
        for (int task = 3 * target + lanes - 1 - lane; task < 3 * last_target; task += lanes) {
            const unsigned row = targets[task / 3];
            const int next = targets[task / 3 + 1] & 0xffff;
            double total = 0.0, more = 0.0, last = 0.0;
            #pragma unroll 2
            for (int e = row & 0xffffu; e < next; ++e) {
                const unsigned entry = entries[e];
                const double* const a = factor + 9 * (entry >> 16) + 3 * (task % 3);
                const double* const u = z + 3 * (entry & 0xffffu);
                total += a[0] * u[0];
                more += a[1] * u[1];
                last += a[2] * u[2];
            }
            z[3 * (row >> 16) + task % 3] -= total + more + last;
        }
        WP_TILE_SYNC();
        target = step_starts[level];
        last_target = step_starts[level + 1];
        if (9 * end + lane < 9 * next_end) {
            begin = pair_starts[end + lane / 9];
            stop = pair_starts[end + lane / 9 + 1];
        }
        #pragma unroll 1
        for (int task = lane; task < 3 / rows * count; task += lanes) {
            const int block = first + task * rows / 3;
            if (task >= lanes)
                owner = owners[block];
            const int diagonal = owner & 0xffffu;
            const int row = rows == 1 ? task % 3 : 0;
            // Of a diagonal block that is the load's: the block itself is still read by others.
            double* a = block == diagonal ? z + 3 * (owner >> 16) : factor + 9 * block + 3 * row;
            double a0 = a[0], a1 = a[1], a2 = a[2];
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
            int left = rows;
            if (block == diagonal) {
                #pragma unroll 1
                for (int i = row; i < row + rows; ++i) {
                    double* const root = roots + 9 * (owner >> 16) + 3 * i;
                    root[0] = i == 0 ? r00 : i == 1 ? r10 : r20;
                    root[1] = i == 0 ? 0.0 : i == 1 ? r11 : r21;
                    root[2] = i == 2 ? r22 : 0.0;
                }
                left = row == 0 ? 1 : 0;
            }
            while (left > 0) {
                a[0] = r00 * a0;
                a[1] = r10 * a0 + r11 * a1;
                a[2] = r20 * a0 + r21 * a1 + r22 * a2;
                left -= 1;
                a += 3;
                if (left > 0) {
                    a0 = a[0];
                    a1 = a[1];
                    a2 = a[2];
                }
            }
        }
        first = end;
        end = next_end;
        WP_TILE_SYNC();
    }

//: finish_factor
@NAMES@
    const int n = layout.n;
    const int m = layout.m;
    const int width = 3 * m;
    const int* const starts = words + layout.starts;
    // Of the Schur complement blocks (i, j), i >= j, and of the load a row of three for each j.
    const int blocks = m * (m + 1) / 2;
    const int products = 9 * blocks + width;
    double* const sums = numbers + layout.sums;
    double* const z = numbers + layout.z;
    #pragma unroll 1
    for (int task = lane; task < @SCHUR_CHUNKS@ * (blocks + m); task += lanes) {
        const int chunk = task / (blocks + m);
        const int own = task % (blocks + m);
        const bool loads = own >= blocks;
        int i = 0, j = own - blocks;
        if (!loads) {
            while ((i + 1) * (i + 2) / 2 <= own)
                ++i;
            j = own - i * (i + 1) / 2;
        }
        double total[9] = {};
        #pragma unroll 2
        for (int column = chunk; column < n; column += @SCHUR_CHUNKS@) {
            const double* const base = factor + 9 * (starts[column] + 1);
            const double* const a = loads ? z + 3 * column : base + 9 * i;
            const double* const b = base + 9 * j;
            #pragma unroll
            for (int r = 0; r < 3; ++r) {
                if (r > 0 && loads)
                    break;
                #pragma unroll
                for (int c = 0; c < 3; ++c)
                    total[3 * r + c] += a[3 * r] * b[3 * c] + a[3 * r + 1] * b[3 * c + 1]
                        + a[3 * r + 2] * b[3 * c + 2];
            }
        }
        double* const sum = sums + chunk * products + (loads ? 9 * blocks + 3 * j : 9 * own);
        #pragma unroll
        for (int e = 0; e < 9; ++e)
            if (e < 3 || !loads)
                sum[e] = total[e];
    }
    WP_TILE_SYNC();
    // From here on nothing needs the factor as it is: A = L D L^T with unit L.
    const double* const roots = numbers + layout.roots;
    const int* const owners = words + layout.owners;
    #pragma unroll 1
    for (int block = lane; block < layout.blocks; block += lanes) {
        const unsigned owner = owners[block];
        double root[9];
        #pragma unroll
        for (int k = 0; k < 9; ++k)
            root[k] = roots[9 * (owner >> 16) + k];
        double* const a = factor + 9 * block;
        const bool diagonal = block == static_cast<int>(owner & 0xffffu);
        #pragma unroll
        for (int i = 0; i < 3; ++i) {
            // Of a diagonal block the inverse, from the roots alone.
            const double a0 = diagonal ? root[i] : a[3 * i];
            const double a1 = diagonal ? root[3 + i] : a[3 * i + 1];
            const double a2 = diagonal ? root[6 + i] : a[3 * i + 2];
            #pragma unroll
            for (int c = 0; c < 3; ++c)
                a[3 * i + c] = a0 * root[c] + a1 * root[3 + c] + a2 * root[6 + c];
        }
        if (diagonal) {
            double* const u = z + 3 * (owner >> 16);
            const double u0 = u[0], u1 = u[1], u2 = u[2];
            #pragma unroll
            for (int c = 0; c < 3; ++c)
                u[c] = u0 * root[c] + u1 * root[3 + c] + u2 * root[6 + c];
        }
    }
    double* const schur = numbers + layout.schur;
    #pragma unroll 1
    for (int e = lane; e < width * width + width; e += lanes) {
        const bool loads = e >= width * width;
        const int i = e / width;
        const int j = e % width;
        // Element (i, j) is that of a block of the lower triangle, or of its transposed.
        const bool above = i / 3 < j / 3;
        const int high = above ? j : i;
        const int low = above ? i : j;
        const int row = high / 3;
        const int at = loads ? 9 * blocks + j
            : 9 * (row * (row + 1) / 2 + low / 3) + 3 * (high % 3) + low % 3;
        double total = 0.0;
        #pragma unroll
        for (int chunk = 0; chunk < @SCHUR_CHUNKS@; ++chunk)
            total += sums[chunk * products + at];
        (loads ? z[3 * n + j] : schur[e]) -= total;
    }
    WP_TILE_SYNC();
    // Gauss-Jordan by blocks, from one copy to the other and back, negative pivots as above.
    double* old = schur;
    double* next = schur + width * width;
    #pragma unroll 1
    for (int pivot = 0; pivot < width; pivot += 3) {
        const auto magnitude = [](double value) { return value < 0.0 ? -value : value; };
        #pragma unroll 1
        for (int e = lane; e < width * width; e += lanes) {
            const int i = e / width;
            const int j = e % width;
            const double* const d = old + pivot * width + pivot;
            // d = L D L^T of the pivot, and what L and D take from its row and column.
            const double d0 = d[0];
            const double v0 = 1.0 / magnitude(d0);
            const double l1 = d[width] * v0;
            const double l2 = d[2 * width] * v0;
            const double d1 = d[width + 1] - l1 * d[width];
            const double v1 = 1.0 / magnitude(d1);
            const double l3 = (d[2 * width + 1] - l2 * d[width]) * v1;
            const double d2 = d[2 * width + 2] - l2 * d[2 * width] - l3 * l3 * magnitude(d1);
            const double v2 = 1.0 / magnitude(d2);
            if (d0 < 0.0 || d1 < 0.0 || d2 < 0.0)
                numbers[layout.flag + 1] = 1.0;
            const bool in_row = i >= pivot && i < pivot + 3;
            const bool in_column = j >= pivot && j < pivot + 3;
            // The column of the pivot is that of the unit matrix.
            double b[3], a[3];
            #pragma unroll
            for (int k = 0; k < 3; ++k) {
                b[k] = in_column ? (j == pivot + k ? 1.0 : 0.0) : old[(pivot + k) * width + j];
                a[k] = in_row ? (i == pivot + k ? -1.0 : 0.0) : old[i * width + pivot + k];
            }
            b[1] -= l1 * b[0];
            b[2] -= l2 * b[0] + l3 * b[1];
            a[1] -= l1 * a[0];
            a[2] -= l2 * a[0] + l3 * a[1];
            const double rest = in_row || in_column ? 0.0 : old[e];
            next[e] = rest - (a[0] * v0 * b[0] + a[1] * v1 * b[1] + a[2] * v2 * b[2]);
        }
        double* const swap = old;
        old = next;
        next = swap;
        WP_TILE_SYNC();
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
    int step = first_solve ? layout.forward_steps : 0;
    int first = step_starts[step], end = step_starts[step + 1], next_end = step_starts[step + 2];
    unsigned target = targets[first + lane / 3];
    int stop = targets[first + lane / 3 + 1] & 0xffff;
    double* y = z;
    int across = 1, down = 3;
    #pragma unroll 1
    for (; step <= layout.step_count; ++step) {
        if (step == layout.forward_steps) {
            const int* const starts = words + layout.starts;
            if (width > 0 && !first_solve) {
                double* const sums = numbers + layout.sums;
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
                    z[3 * n + i] = total - more;
                }
                WP_TILE_SYNC();
            }
            if (width > 0) {
                const double* const rest = z + 3 * n;
                const double* const inverse = numbers + layout.schur + layout.m % 2 * width * width;
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
                double total = u[c];
                if (!first_solve)
                    total = own[3 * c] * u[0] + own[3 * c + 1] * u[1] + own[3 * c + 2] * u[2];
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
