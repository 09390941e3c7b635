// Plays what Unity does with a HapticMaster: enables it, calls its fixed updates in real time, and disables it.
using System;
using System.Globalization;
using System.Threading;
using Hapticnet;
using Hapticnet.Unity;
using UnityEngine;

internal static class Life
{
    private static int Main(string[] arguments)
    {
        CultureInfo.DefaultThreadCurrentCulture = CultureInfo.InvariantCulture;
        Thread.CurrentThread.CurrentCulture = CultureInfo.InvariantCulture;
        var component = new HapticMaster { port = int.Parse(arguments[0]), body = new Rigidbody() };
        double seconds = double.Parse(arguments[1]);
        component.frame = new Transform { position = new Vector3(1.0f, 2.0f, 3.0f), scale = 10.0f, turned = true };
        if (arguments.Length > 2)
            component.slaveKey = arguments[2];
        if (arguments.Length > 3)
            component.keyFile = arguments[3];
        Vector3 told = Vector3.zero;
        component.onForce.AddListener(force => told = force);

        component.transform.position = component.frame.position;
        component.enabled = true;
        long start = Node.NowUs;
        int steps = (int)(seconds / Time.fixedDeltaTime);
        for (int step = 0; step < steps && component.enabled; step++)
        {
            while (Node.NowUs - start < step * Time.fixedDeltaTime * 1e6)
                Thread.Sleep(1);
            // Forward in the frame is to the right in the world; 10 units there are a metre of the scene.
            float depth_m = (float)(0.015 * (1.0 - Math.Cos(2.0 * Math.PI * step / steps)));
            component.transform.position.x = 1.0f + 10.0f * depth_m;
            component.Send("FixedUpdate");
            if (step % 5 == 0)
                Console.WriteLine("{0:0.00} mm {1:0.00} {2:0.00} {3:0.00} N", depth_m * 1e3, told.x, told.y, told.z);
            if (told.x != component.body.force.x)
                Console.WriteLine("error the event and the body differ");
        }
        if (component.Link != null)
            Console.WriteLine("ticks {0} missed {1}", component.Link.Ticks, component.Link.MissedTicks);
        component.enabled = false;
        Console.WriteLine("force {0} link {1}", component.Force.magnitude, component.Link == null ? "none" : "some");
        return 0;
    }
}
