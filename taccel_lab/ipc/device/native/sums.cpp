// SPDX-License-Identifier: Apache-2.0

//: lower_to
    double* const place = wp::address(values, env);
#if defined(__CUDA_ARCH__)
    atomicMin(reinterpret_cast<long long*>(place), __double_as_longlong(value));
#else
    if (value < *place) *place = value;
#endif

//: vector_exponent
    int largest = 0;
    for (int i = 0; i < 3; ++i) {
        union { double value; unsigned long long bits; } number;
        number.value = value[i];
        const int exponent = static_cast<int>(number.bits >> 52) & 2047;
        largest = exponent > largest ? exponent : largest;
    }
    return largest;

//: block_exponent
    int largest = 0;
    for (int i = 0; i < 9; ++i) {
        union { double value; unsigned long long bits; } number;
        number.value = block.data[i / 3][i % 3];
        const int exponent = static_cast<int>(number.bits >> 52) & 2047;
        largest = exponent > largest ? exponent : largest;
    }
    return largest;

//: anchor_of
    union { double value; unsigned long long bits; } number;
    number.value = static_cast<double>(count);
    const int doublings = (static_cast<int>(number.bits >> 52) & 2047) - 1023;
    const int place = exponent + doublings + 2;
    number.bits = static_cast<unsigned long long>(place < 2047 ? place : 2047) << 52 | 1ull << 51;
    return number.value;

//: rounded_block
    wp::mat_t<3, 3, wp::float64> rounded;
    for (int i = 0; i < 9; ++i)
        rounded.data[i / 3][i % 3] = (block.data[i / 3][i % 3] + anchor) - anchor;
    return rounded;

//: add_rounded
    double* const entry = reinterpret_cast<double*>(
        totals.data + size_t(env) * totals.shape[1] + place);
    for (int i = 0; i < 3; ++i) {
        double addend = value[i];
        if (anchor != 0.0)
            addend = (addend + anchor) - anchor;
#if defined(__CUDA_ARCH__)
        atomicAdd(entry + i, addend);
#else
        entry[i] += addend;
#endif
    }
