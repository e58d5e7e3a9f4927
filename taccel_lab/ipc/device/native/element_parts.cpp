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
    // One thread waits for parts from all over the memory, unless it has asked for them before.
    const int ahead = 12;
    const int last = static_cast<int>(sources.shape[0]) - 1;
    typedef double four __attribute__((vector_size(32), aligned(8)));
    four low = *reinterpret_cast<const four*>(to), high = *reinterpret_cast<const four*>(to + 4);
    double ninth = to[8];
    for (int k = first; k < end; ++k) {
        const int later = codes[k + ahead < last ? k + ahead : last];
        __builtin_prefetch(from + 9 * static_cast<size_t>(later >> 1));
        __builtin_prefetch(from + 9 * static_cast<size_t>(later >> 1) + 8);
        const double* const part = from + 9 * static_cast<size_t>(codes[k] >> 1);
        if (codes[k] & 1) {
            low += four{part[0], part[3], part[6], part[1]};
            high += four{part[4], part[7], part[2], part[5]};
        } else {
            low += *reinterpret_cast<const four*>(part);
            high += *reinterpret_cast<const four*>(part + 4);
        }
        ninth += part[8];
    }
    *reinterpret_cast<four*>(to) = low;
    *reinterpret_cast<four*>(to + 4) = high;
    to[8] = ninth;
#endif
