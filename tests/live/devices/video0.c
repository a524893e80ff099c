/* Put before the C library (LD_PRELOAD): a camera at /dev/video0 that answers as the kernel's documentation of V4L2 says.
   It gives 64 x 48 pixels at 30 frames/s whatever is asked. From the environment: JPEG (a file), ERRNO (refuses so), GONE
   and SILENT (after as many pictures), BAD (every fifth cannot be read, every fifth is flagged), OTHER (another clock), META. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/videodev2.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

enum { WIDTH = 64, HEIGHT = 48, SIZE = 65536, BUFFERS = 4 };
static int device = -1, waits, queued[64], in_queue, count;
static unsigned packed;
static double last;
static char jpeg[SIZE];
static size_t jpeg_size;

static int number(const char *name, int otherwise) { return getenv(name) ? atoi(getenv(name)) : otherwise; }

static double now(void) {
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return time.tv_sec + 1e-9 * time.tv_nsec;
}

static int refuse(int why) {
    errno = why;
    return -1;
}

static int open_camera(int flags) {
    if (number("ERRNO", 0)) return refuse(number("ERRNO", 0));
    FILE *file = fopen(getenv("JPEG"), "rb");
    jpeg_size = fread(jpeg, 1, SIZE, file);
    fclose(file);
    device = memfd_create("video0", 0);
    if (ftruncate(device, BUFFERS * SIZE)) return -1;
    waits = !(flags & O_NONBLOCK);
    last = now();
    return device;
}

#define OPEN(name)                                                                        \
    int name(const char *path, int flags, ...) {                                          \
        va_list more;                                                                     \
        va_start(more, flags);                                                            \
        int mode = va_arg(more, int);                                                     \
        va_end(more);                                                                     \
        if (!strcmp(path, "/dev/video0")) return open_camera(flags);                      \
        return ((int (*)(const char *, int, int))dlsym(RTLD_NEXT, #name))(path, flags, mode); \
    }
OPEN(open)
OPEN(open64)

static void draw(char *picture, int bytes) {
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++) {
            picture[(y * WIDTH + x) * bytes] = 20 + x * 210 / (WIDTH - 1);
            if (bytes == 2) picture[(y * WIDTH + x) * bytes + 1] = 128;
        }
}

static int take(struct v4l2_buffer *buffer) {
    if (count >= number("GONE", 1 << 30)) return refuse(ENODEV);
    while (now() < last + 1.0 / 30.0 || !in_queue || count >= number("SILENT", 1 << 30)) {
        if (!waits) return refuse(EAGAIN);
        usleep(1000);
    }
    last += 1.0 / 30.0;
    int index = queued[0], bad = number("BAD", 0) && count % 5 == 3, flagged = number("BAD", 0) && count % 5 == 4;
    memmove(queued, queued + 1, sizeof(int) * --in_queue);
    char *picture = mmap(0, SIZE, PROT_WRITE, MAP_SHARED, device, (long)index * SIZE);
    if (packed == V4L2_PIX_FMT_MJPEG) {
        memcpy(picture, bad ? "no JPEG" : jpeg, bad ? 7 : jpeg_size);
        buffer->bytesused = bad ? 7 : jpeg_size;
    } else {
        draw(picture, packed == V4L2_PIX_FMT_YUYV ? 2 : 1);
        buffer->bytesused = WIDTH * HEIGHT * (packed == V4L2_PIX_FMT_YUYV ? 2 : 1);
    }
    munmap(picture, SIZE);
    double stamp = last + number("OTHER", 0);
    buffer->index = index;
    buffer->flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | (flagged ? V4L2_BUF_FLAG_ERROR : 0);
    buffer->timestamp.tv_sec = (long)stamp;
    buffer->timestamp.tv_usec = (stamp - (long)stamp) * 1e6;
    buffer->sequence = count++;
    return 0;
}

int ioctl(int handle, unsigned long request, ...) {
    va_list more;
    va_start(more, request);
    void *data = va_arg(more, void *);
    va_end(more);
    if (handle != device) return ((int (*)(int, unsigned long, void *))dlsym(RTLD_NEXT, "ioctl"))(handle, request, data);
    switch ((unsigned)request) {
    case (unsigned)VIDIOC_QUERYCAP:
        ((struct v4l2_capability *)data)->capabilities =
            V4L2_CAP_STREAMING | (number("META", 0) ? V4L2_CAP_META_CAPTURE : V4L2_CAP_VIDEO_CAPTURE);
        return 0;
    case (unsigned)VIDIOC_G_INPUT:
        *(int *)data = 0;
        return 0;
    case (unsigned)VIDIOC_ENUMINPUT:
        return ((struct v4l2_input *)data)->index ? refuse(EINVAL) : 0;
    case (unsigned)VIDIOC_S_FMT: {
        struct v4l2_pix_format *form = &((struct v4l2_format *)data)->fmt.pix;
        packed = form->pixelformat;
        fprintf(stderr, "asked: %ux%u %.4s\n", form->width, form->height, (char *)&packed);
        form->width = WIDTH;
        form->height = HEIGHT;
        form->field = V4L2_FIELD_NONE;
        form->sizeimage = packed == V4L2_PIX_FMT_MJPEG ? SIZE : WIDTH * HEIGHT * (packed == V4L2_PIX_FMT_YUYV ? 2 : 1);
        return 0;
    }
    case (unsigned)VIDIOC_G_PARM: {
        struct v4l2_captureparm *pace = &((struct v4l2_streamparm *)data)->parm.capture;
        pace->capability = V4L2_CAP_TIMEPERFRAME;
        pace->timeperframe = (struct v4l2_fract){1, 30};
        return 0;
    }
    case (unsigned)VIDIOC_S_PARM: {
        struct v4l2_fract pace = ((struct v4l2_streamparm *)data)->parm.capture.timeperframe;
        fprintf(stderr, "pace: %u/%u\n", pace.numerator, pace.denominator);
        return 0;
    }
    case (unsigned)VIDIOC_REQBUFS:
        ((struct v4l2_requestbuffers *)data)->count = BUFFERS;
        return 0;
    case (unsigned)VIDIOC_QUERYBUF:
        ((struct v4l2_buffer *)data)->length = SIZE;
        ((struct v4l2_buffer *)data)->m.offset = ((struct v4l2_buffer *)data)->index * SIZE;
        return 0;
    case (unsigned)VIDIOC_QBUF:
        queued[in_queue++] = ((struct v4l2_buffer *)data)->index;
        return 0;
    case (unsigned)VIDIOC_DQBUF:
        return take(data);
    case (unsigned)VIDIOC_STREAMON:
    case (unsigned)VIDIOC_STREAMOFF:
        return 0;
    }
    return refuse(EINVAL);
}
