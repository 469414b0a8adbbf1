// SPDX-License-Identifier: MIT OR Apache-2.0

/* Rectifies raw frames of an application by GStreamer: appsrc → rsrectify → appsink.
 *
 *   cc -o rectify_frames rectify_frames.c $(pkg-config --cflags --libs gstreamer-app-1.0 gstreamer-video-1.0)
 *   ./rectify_frames IN.raw OUT.raw FORMAT WIDTH HEIGHT FRAMES_PER_SECOND
 *
 * IN.raw holds frames without padding, one after the other; FORMAT is GStreamer's name of their pixel
 * format, such as I420 or GRAY8. What was found in each frame is printed.
 */
#include <gst/app/app.h>
#include <gst/video/video.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>

/* How long to wait for a frame before the bus is asked for an error. */
#define PATIENCE GST_SECOND

/* The frames that go into the pipeline. */
typedef struct {
    FILE *file;
    GstVideoInfo info;
    guint64 count;
} Input;

/* Called by appsrc, in its own thread, whenever it wants a frame: frames are read no faster than they
 * are worked on. */
static void push_frame(GstAppSrc *source, guint unused, gpointer data)
{
    Input *input = data;
    gsize size = GST_VIDEO_INFO_SIZE(&input->info);
    gint rate = GST_VIDEO_INFO_FPS_N(&input->info);
    (void) unused;

    guint8 *pixels = g_malloc(size);
    if (fread(pixels, 1, size, input->file) != size) {
        if (!feof(input->file))
            GST_ELEMENT_ERROR(source, RESOURCE, READ, ("Cannot read the frames."), (NULL));
        g_free(pixels);
        gst_app_src_end_of_stream(source);
        return;
    }
    /* The buffer takes over the memory. */
    GstBuffer *buffer = gst_buffer_new_wrapped(pixels, size);
    /* Each frame needs the time at which it was taken: the readout is found in time, not in rows. */
    GST_BUFFER_PTS(buffer) = gst_util_uint64_scale(input->count, GST_SECOND, rate);
    GST_BUFFER_DURATION(buffer) = gst_util_uint64_scale(1, GST_SECOND, rate);
    input->count++;
    /* So does push_buffer the buffer, also where it fails; a failure is on the bus. */
    gst_app_src_push_buffer(source, buffer);
}

static const char *name_of(const GValue *value)
{
    if (value == NULL || !G_VALUE_HOLDS_ENUM(value))
        return "unknown";
    GEnumValue *entry = g_enum_get_value(g_type_class_peek(G_VALUE_TYPE(value)), g_value_get_enum(value));
    return entry == NULL ? "unknown" : entry->value_nick;
}

/* Prints what the element says of a frame. */
static void print_meta(GstBuffer *buffer, guint64 number)
{
    printf("frame %" G_GUINT64_FORMAT ": %.3f s", number, (double) GST_BUFFER_PTS(buffer) / GST_SECOND);
    GstCustomMeta *meta = gst_buffer_get_custom_meta(buffer, "RsRectifyMeta");
    if (meta == NULL) {
        /* Frames that are passed through, interlaced ones for example, have none. */
        printf(", no motion\n");
        return;
    }
    /* The structure belongs to the meta, and the meta to the buffer. */
    GstStructure *found = gst_custom_meta_get_structure(meta);
    guint64 readout = 0;
    gdouble confidence = 0.0, error = 0.0;
    gst_structure_get(found, "readout-time", G_TYPE_UINT64, &readout, "confidence", G_TYPE_DOUBLE, &confidence, NULL);
    printf(", readout %.1f ms %s, confidence %.2f", (double) readout / GST_MSECOND,
           name_of(gst_structure_get_value(found, "readout-direction")), confidence);
    /* Absent where it cannot be told. */
    if (gst_structure_get_double(found, "expected-error", &error))
        printf(", expected error %.2f px", error);
    printf("\n");
}

static bool write_frame(GstBuffer *buffer, FILE *out)
{
    GstMapInfo map;
    if (!gst_buffer_map(buffer, &map, GST_MAP_READ))
        return false;
    /* All of it: without GstVideoMeta, for which appsink does not ask, rows have no padding. */
    bool written = fwrite(map.data, 1, map.size, out) == map.size;
    gst_buffer_unmap(buffer, &map);
    return written;
}

/* Whether an error is on the bus; prints it. */
static bool failed(GstBus *bus)
{
    GstMessage *message = gst_bus_pop_filtered(bus, GST_MESSAGE_ERROR);
    if (message == NULL)
        return false;
    GError *error = NULL;
    gst_message_parse_error(message, &error, NULL);
    fprintf(stderr, "%s: %s\n", GST_OBJECT_NAME(message->src), error->message);
    g_error_free(error);
    gst_message_unref(message);
    return true;
}

/* Takes frames out of the pipeline until there are no more. */
static bool take_frames(GstAppSink *sink, GstBus *bus, FILE *out)
{
    for (guint64 number = 0;;) {
        GstSample *sample = gst_app_sink_try_pull_sample(sink, PATIENCE);
        if (sample == NULL) {
            if (failed(bus))
                return false;
            if (gst_app_sink_is_eos(sink))
                return true;
            continue;
        }
        GstBuffer *buffer = gst_sample_get_buffer(sample);
        print_meta(buffer, number++);
        bool written = write_frame(buffer, out);
        gst_sample_unref(sample);
        if (!written) {
            perror("Cannot write the frames");
            return false;
        }
    }
}

static bool run(Input *input, FILE *out)
{
    GError *error = NULL;
    GstElement *pipeline = gst_parse_launch(
        "appsrc name=in format=time ! rsrectify attach-meta=true ! appsink name=out sync=false max-buffers=4", &error);
    /* A pipeline may be there in part beside an error. */
    if (error != NULL) {
        fprintf(stderr, "%s\nGST_PLUGIN_PATH must name the folder of libgstrsrectify.so.\n", error->message);
        g_error_free(error);
        g_clear_pointer(&pipeline, gst_object_unref);
        return false;
    }
    GstAppSrc *source = GST_APP_SRC(gst_bin_get_by_name(GST_BIN(pipeline), "in"));
    GstAppSink *sink = GST_APP_SINK(gst_bin_get_by_name(GST_BIN(pipeline), "out"));
    GstBus *bus = gst_element_get_bus(pipeline);

    GstCaps *caps = gst_video_info_to_caps(&input->info);
    gst_app_src_set_caps(source, caps);
    gst_caps_unref(caps);
    GstAppSrcCallbacks callbacks = {.need_data = push_frame};
    gst_app_src_set_callbacks(source, &callbacks, input, NULL);

    bool done = gst_element_set_state(pipeline, GST_STATE_PLAYING) != GST_STATE_CHANGE_FAILURE;
    if (done)
        done = take_frames(sink, bus, out);
    else
        failed(bus);
    /* Ends the thread that reads `input`, which the caller closes next. */
    gst_element_set_state(pipeline, GST_STATE_NULL);

    gst_object_unref(bus);
    gst_object_unref(sink);
    gst_object_unref(source);
    gst_object_unref(pipeline);
    return done;
}

int main(int argc, char **argv)
{
    gst_init(&argc, &argv);
    if (argc != 7) {
        fprintf(stderr, "usage: %s IN.raw OUT.raw FORMAT WIDTH HEIGHT FRAMES_PER_SECOND\n", argv[0]);
        return 2;
    }
    Input input = {0};
    GstVideoFormat format = gst_video_format_from_string(argv[3]);
    int width = atoi(argv[4]), height = atoi(argv[5]), rate = atoi(argv[6]);
    if (format == GST_VIDEO_FORMAT_UNKNOWN || width <= 0 || height <= 0 || rate <= 0 ||
        !gst_video_info_set_format(&input.info, format, width, height)) {
        fprintf(stderr, "Not a format and size of frames: %s %s %s %s\n", argv[3], argv[4], argv[5], argv[6]);
        return 2;
    }
    GST_VIDEO_INFO_FPS_N(&input.info) = rate;
    GST_VIDEO_INFO_FPS_D(&input.info) = 1;

    bool done = false;
    input.file = fopen(argv[1], "rb");
    if (input.file == NULL) {
        perror(argv[1]);
    } else {
        FILE *out = fopen(argv[2], "wb");
        if (out == NULL) {
            perror(argv[2]);
        } else {
            done = run(&input, out);
            /* What is still in the buffer of the file may not fit onto the disk. */
            if (fclose(out) != 0) {
                perror(argv[2]);
                done = false;
            }
        }
        fclose(input.file);
    }
    gst_deinit();
    return done ? 0 : 1;
}
