/* What all sources share: export of functions, bounds that keep NaN, and the layout of structs for their mirrors. */
#ifndef COMMON_H
#define COMMON_H

#include <stddef.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* As numpy's maximum and minimum: NaN where either is NaN. The standard library's fmax and fmin take the other number
 * then, and a bound of NaN would be full thrust. */
static inline double at_least(double value, double least) { return value > least || value != value ? value : least; }
static inline double at_most(double value, double most) { return value < most || value != value ? value : most; }
static inline double clamp(double value, double least, double most) { return at_most(at_least(value, least), most); }

/* Row at or below `place` of `count` that are interpolated, the last but one at most; 0 for NaN: the share above it
 * then makes the value NaN, while NaN as an index would be any address. */
static inline long row_below(double place, long count) {
    return place > 0.0 ? (long)(place < (double)(count - 2) ? place : (double)(count - 2)) : 0;
}

/* LAYOUT(Type, field, ...) behind a struct exports `layout_Type`: size of the struct, number of its fields, and name,
 * offset and size of each, which autopilot/core/compiled.py compares with the mirror in Python. */
typedef struct {
    const char *name;
    long offset, size;
} FieldLayout;

typedef struct {
    long size, count;
    FieldLayout fields[32];
} StructLayout;

#define FIELD_1(type, field) {#field, (long)offsetof(type, field), (long)sizeof(((type *)0)->field)}
#define FIELD_2(type, field, ...) FIELD_1(type, field), FIELD_1(type, __VA_ARGS__)
#define FIELD_3(type, field, ...) FIELD_1(type, field), FIELD_2(type, __VA_ARGS__)
#define FIELD_4(type, field, ...) FIELD_1(type, field), FIELD_3(type, __VA_ARGS__)
#define FIELD_5(type, field, ...) FIELD_1(type, field), FIELD_4(type, __VA_ARGS__)
#define FIELD_6(type, field, ...) FIELD_1(type, field), FIELD_5(type, __VA_ARGS__)
#define FIELD_7(type, field, ...) FIELD_1(type, field), FIELD_6(type, __VA_ARGS__)
#define FIELD_8(type, field, ...) FIELD_1(type, field), FIELD_7(type, __VA_ARGS__)
#define FIELD_9(type, field, ...) FIELD_1(type, field), FIELD_8(type, __VA_ARGS__)
#define FIELD_10(type, field, ...) FIELD_1(type, field), FIELD_9(type, __VA_ARGS__)
#define FIELD_11(type, field, ...) FIELD_1(type, field), FIELD_10(type, __VA_ARGS__)
#define FIELD_12(type, field, ...) FIELD_1(type, field), FIELD_11(type, __VA_ARGS__)
#define FIELD_13(type, field, ...) FIELD_1(type, field), FIELD_12(type, __VA_ARGS__)
#define FIELD_14(type, field, ...) FIELD_1(type, field), FIELD_13(type, __VA_ARGS__)
#define FIELD_15(type, field, ...) FIELD_1(type, field), FIELD_14(type, __VA_ARGS__)
#define FIELD_16(type, field, ...) FIELD_1(type, field), FIELD_15(type, __VA_ARGS__)
#define FIELD_17(type, field, ...) FIELD_1(type, field), FIELD_16(type, __VA_ARGS__)
#define FIELD_18(type, field, ...) FIELD_1(type, field), FIELD_17(type, __VA_ARGS__)
#define FIELD_19(type, field, ...) FIELD_1(type, field), FIELD_18(type, __VA_ARGS__)
#define FIELD_20(type, field, ...) FIELD_1(type, field), FIELD_19(type, __VA_ARGS__)
#define FIELD_21(type, field, ...) FIELD_1(type, field), FIELD_20(type, __VA_ARGS__)
#define FIELD_22(type, field, ...) FIELD_1(type, field), FIELD_21(type, __VA_ARGS__)
#define FIELD_23(type, field, ...) FIELD_1(type, field), FIELD_22(type, __VA_ARGS__)
#define FIELD_24(type, field, ...) FIELD_1(type, field), FIELD_23(type, __VA_ARGS__)
#define FIELD_25(type, field, ...) FIELD_1(type, field), FIELD_24(type, __VA_ARGS__)
#define FIELD_26(type, field, ...) FIELD_1(type, field), FIELD_25(type, __VA_ARGS__)
#define FIELD_27(type, field, ...) FIELD_1(type, field), FIELD_26(type, __VA_ARGS__)
#define FIELD_28(type, field, ...) FIELD_1(type, field), FIELD_27(type, __VA_ARGS__)
#define FIELD_29(type, field, ...) FIELD_1(type, field), FIELD_28(type, __VA_ARGS__)
#define FIELD_30(type, field, ...) FIELD_1(type, field), FIELD_29(type, __VA_ARGS__)
#define FIELD_31(type, field, ...) FIELD_1(type, field), FIELD_30(type, __VA_ARGS__)
#define FIELD_32(type, field, ...) FIELD_1(type, field), FIELD_31(type, __VA_ARGS__)
#define FIELDS_NTH(a32, a31, a30, a29, a28, a27, a26, a25, a24, a23, a22, a21, a20, a19, a18, a17, a16, a15, a14, a13, \
    a12, a11, a10, a9, a8, a7, a6, a5, a4, a3, a2, a1, count, ...) count
#define FIELDS_COUNT(...) FIELDS_NTH(__VA_ARGS__, 32, 31, 30, 29, 28, 27, 26, 25, 24, 23, 22, 21, 20, 19, 18, 17, 16, \
    15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0)
#define FIELDS_JOIN_(a, b) a##b
#define FIELDS_JOIN(a, b) FIELDS_JOIN_(a, b)
#define LAYOUT(type, ...)                              \
    EXPORT extern const StructLayout layout_##type;    \
    const StructLayout layout_##type = {               \
        (long)sizeof(type), FIELDS_COUNT(__VA_ARGS__), \
        {FIELDS_JOIN(FIELD_, FIELDS_COUNT(__VA_ARGS__))(type, __VA_ARGS__)}};

#endif
