/* Plays recorded blobs into a run, as a camera system would send them: blobs INSTANCE FILE (FILE by lines.py).
 * The run: vitreo run --external blobs,handles,pedal --rig RIG.json --instance INSTANCE */
#define _GNU_SOURCE
#include "vitreo.h"
#include <inttypes.h>
#include <stdio.h>
#include <time.h>

#define PERIOD_NS UINT64_C(20000000)

static void sleep_until(uint64_t ns) {
    struct timespec at = {.tv_sec = ns / 1000000000, .tv_nsec = ns % 1000000000};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL);
}

static int read_blobs(FILE *file, VitreoBlobField *field, uint32_t count) {
    for (uint32_t i = 0; i < count; i++) {
        VitreoBlob b = {.var_x_px2 = 0.0025, .var_y_px2 = 0.0025};
        if (fscanf(file, "%lf %lf %lf %lf %lf %u", &b.x_px, &b.y_field_px, &b.area_px, &b.width_px,
                   &b.height_px, &b.colour) != 6)
            return -1;
        if (i < VITREO_MAX_BLOBS)
            field->blobs[field->count++] = b;
    }
    return 0;
}

int main(int argc, char **argv) {
    FILE *file = argc == 3 ? fopen(argv[2], "r") : NULL;
    uint64_t driver, start, seq, exposed, received, first = 0;
    uint32_t camera, parity, count, roles = VITREO_SENDS_BLOBS | VITREO_SENDS_HANDLES | VITREO_SENDS_PEDAL;
    int code = file ? vitreo_open(argv[1], "c-example", roles, VITREO_LAYOUT, 30000, &driver) : VITREO_ARGUMENT;
    if (code != VITREO_OK) {
        fprintf(stderr, "%s\n", file ? vitreo_error_text() : "usage: blobs INSTANCE FILE");
        return 1;
    }
    start = vitreo_now();
    while (code == VITREO_OK && fscanf(file, "%u %" SCNu64 " %" SCNu64 " %" SCNu64 " %u %u", &camera, &seq,
                                       &exposed, &received, &parity, &count) == 6) {
        first = first ? first : received;
        /* Numbers go on rising where this program is started again. */
        VitreoBlobField field = {.field = start / PERIOD_NS + seq, .exposed_ns = start + exposed - first,
                                 .read_out_ns = start + received - first, .camera = camera, .parity = parity};
        if (read_blobs(file, &field, count) != 0)
            break;
        sleep_until(field.read_out_ns);
        code = vitreo_send_blobs(driver, &field, sizeof field);
        for (uint32_t i = 0; camera == 0 && i < VITREO_INSTRUMENTS && code == VITREO_OK; i++) {
            VitreoHandleState handle = {.field = field.field, .instrument = i, .tool = 1 + i, .jaw_rad = i ? 0 : 0.4};
            VitreoPedalState pedal = {.mode = VITREO_PEDAL_MODE_MOVE};
            code = vitreo_send_handle(driver, &handle, sizeof handle);
            code = code == VITREO_OK ? vitreo_send_pedal(driver, &pedal, sizeof pedal) : code;
        }
    }
    for (vitreo_finish(driver); vitreo_check(driver) == VITREO_OK;) /* the run ends in order */
        sleep_until(vitreo_now() + PERIOD_NS);
    fprintf(stderr, "%s\n", vitreo_error_text());
    return vitreo_close(driver) != VITREO_OK || code < 0;
}
