// SPDX-License-Identifier: Apache-2.0

//: add_parts
    const size_t row = static_cast<size_t>(env) * parts.shape[1];
    const double* const from = reinterpret_cast<const double*>(parts.data + row);
    double* const to = reinterpret_cast<double*>(
        values.data + static_cast<size_t>(env) * values.shape[1] + block);
    const wp::int32* const codes = sources.data;
#if defined(__CUDA_ARCH__)
    double total[9], part[9];
    for (int i = 0; i < 9; ++i)
        total[i] = to[i];
    for (int k = first; k < end; ++k) {
        const int code = codes[k];
        const double* const next = from + 9 * static_cast<size_t>(code >> 1);
        for (int i = 0; i < 9; ++i)
            part[i] = next[i];
        for (int i = 0; i < 9; ++i)
            total[i] += code & 1 ? part[i % 3 * 3 + i / 3] : part[i];
    }
    for (int i = 0; i < 9; ++i)
        to[i] = total[i];
#else
@NINE@
    // One thread waits for parts from all over the memory, unless it has asked for them before.
    const int ahead = 12;
    const int last = static_cast<int>(sources.shape[0]) - 1;
    Nine total(to, false);
    for (int k = first; k < end; ++k) {
        const int later = codes[k + ahead < last ? k + ahead : last];
        __builtin_prefetch(from + 9 * static_cast<size_t>(later >> 1));
        __builtin_prefetch(from + 9 * static_cast<size_t>(later >> 1) + 8);
        total.add(Nine(from + 9 * static_cast<size_t>(codes[k] >> 1), codes[k] & 1));
    }
    total.write(to);
#endif

//: nine
    // A block on the CPU, in vectors.
    struct Nine {
        typedef double four __attribute__((vector_size(32), aligned(8)));
        four low, high;
        double ninth;
        Nine(const double* b, bool turned) : ninth(b[8]) {
            if (turned) {
                low = four{b[0], b[3], b[6], b[1]};
                high = four{b[4], b[7], b[2], b[5]};
            } else {
                low = *reinterpret_cast<const four*>(b);
                high = *reinterpret_cast<const four*>(b + 4);
            }
        }
        void add(const Nine& other) {
            low += other.low;
            high += other.high;
            ninth += other.ninth;
        }
        void subtract(const Nine& other) {
            low -= other.low;
            high -= other.high;
            ninth -= other.ninth;
        }
        void write(double* to) const {
            *reinterpret_cast<four*>(to) = low;
            *reinterpret_cast<four*>(to + 4) = high;
            to[8] = ninth;
        }
    };
